"""The vectors of Nie 1988, chapter II, component by component: Tables 1 and 2, velocities, accelerations, weights.

`w2_B3` is the third component of w_2^B, in the frame of B; what is not listed is zero. Those of F* and of its weight are in the
frame of E, all others in that of their own link. UP1 stands for the rate of u1.
"""

# Table 1, partial angular velocities.
PARTIAL_ANGULAR = """
w1_A2 = Z4
w2_A2 = Z5
w1_B1 = c3
w1_B2 = s3
w1_B3 = Z8
w2_B1 = -s3
w2_B2 = c3
w2_B3 = Z9
w1_C1 = 1
w2_C2 = 1
w3_C3 = 1
w1_D1 = c4
w1_D2 = -s4
w2_D1 = s4
w2_D2 = c4
w3_D3 = 1
w4_D3 = 1
w1_E1 = Z14
w1_E3 = Z16
w2_E1 = Z15
w2_E3 = Z14
w3_E2 = -1
w4_E2 = -1
w5_E2 = -1
w1_F1 = Z20
w1_F2 = -Z22
w1_F3 = Z16
w2_F1 = Z21
w2_F2 = -Z23
w2_F3 = Z14
w3_F1 = -s6
w3_F2 = -c6
w4_F1 = -s6
w4_F2 = -c6
w5_F1 = -s6
w5_F2 = -c6
w6_F3 = 1
"""

# Table 2, partial velocities of the mass centres.
PARTIAL_LINEAR = """
v1_A1 = Z27
v2_A1 = Z28
v1_B1 = Z30
v1_B3 = Z32
v2_B1 = Z31
v2_B3 = Z33
v1_C1 = 0
v1_C2 = -L33
v2_C1 = L33
v2_C3 = -L31
v3_C2 = L31
v1_D1 = -Z39
v1_D2 = -Z40
v1_D3 = Z43
v2_D1 = Z40
v2_D2 = -Z39
v2_D3 = -Z44
v3_D1 = Z41
v3_D2 = Z42
v4_D2 = L41
v1_E1 = Z54
v1_E2 = -Z49
v1_E3 = -Z55
v2_E1 = Z55
v2_E2 = Z50
v2_E3 = Z54
v3_E1 = Z56
v3_E3 = Z58
v4_E1 = Z57
v4_E3 = Z59
v1_F1 = Z64
v1_F2 = Z68
v1_F3 = -Z65
v2_F1 = Z65
v2_F2 = Z69
v2_F3 = Z64
v3_F1 = Z66
v3_F3 = Z58
v4_F1 = Z67
v4_F3 = Z59
v5_F1 = -L63
"""

# Velocities in the form that shows u1 to u6: (2.27) to (2.32), and of P, the point of C on the axis of D, in the frame of C.
VELOCITIES = """
v_A1 = Z27 * u1 + Z28 * u2
v_B1 = Z30 * u1 + Z31 * u2
v_B3 = Z32 * u1 + Z33 * u2
v_C1 = L33 * u2
v_C2 = L31 * u3 - L33 * u1
v_C3 = -L31 * u2
v_P1 = L33 * u2
v_P2 = L1 * u3 - L33 * u1
v_P3 = -L1 * u2
v_D1 = -Z39 * u1 + Z40 * u2 + Z41 * u3
v_D2 = -Z40 * u1 - Z39 * u2 + Z42 * u3 + L41 * u4
v_D3 = Z43 * u1 - Z44 * u2
v_E1 = Z54 * u1 + Z55 * u2 + Z56 * u3 + Z57 * u4
v_E2 = -Z49 * u1 + Z50 * u2
v_E3 = -Z55 * u1 + Z54 * u2 + Z58 * u3 + Z59 * u4
v_F1 = Z64 * u1 + Z65 * u2 + Z66 * u3 + Z67 * u4 - L63 * u5
v_F2 = Z68 * u1 + Z69 * u2
v_F3 = -Z65 * u1 + Z64 * u2 + Z58 * u3 + Z59 * u4
"""

# Angular accelerations, (2.33) to (2.38).
ANGULAR_ACCELERATIONS = """
alpha_A2 = Z4 * UP1 + Z5 * UP2 + Z75
alpha_B1 = c3 * UP1 - s3 * UP2 + Z78
alpha_B2 = s3 * UP1 + c3 * UP2 + Z79
alpha_B3 = Z8 * UP1 + Z9 * UP2 + Z80
alpha_C1 = UP1
alpha_C2 = UP2
alpha_C3 = UP3
alpha_D1 = c4 * UP1 + s4 * UP2 + Z81
alpha_D2 = -s4 * UP1 + c4 * UP2 + Z82
alpha_D3 = UP3 + UP4
alpha_E1 = Z14 * UP1 + Z15 * UP2 + Z85
alpha_E2 = -(UP3 + UP4 + UP5)
alpha_E3 = Z16 * UP1 + Z14 * UP2 + Z86
alpha_F1 = Z20 * UP1 + Z21 * UP2 - s6 * (UP3 + UP4 + UP5) + Z91
alpha_F2 = -(Z22 * UP1 + Z23 * UP2 + c6 * (UP3 + UP4 + UP5) + Z92)
alpha_F3 = Z16 * UP1 + Z14 * UP2 + UP6 + Z93
"""

# Accelerations of the mass centres, (2.40) to (2.45).
ACCELERATIONS = """
a_A1 = Z27 * UP1 + Z28 * UP2 + Z94
a_A3 = Z95
a_B1 = Z30 * UP1 + Z31 * UP2 + Z100
a_B2 = Z101
a_B3 = Z32 * UP1 + Z33 * UP2 + Z102
a_C1 = L33 * UP2 + Z103
a_C2 = -L33 * UP1 + L31 * UP3 + Z104
a_C3 = -L31 * UP2 + Z105
a_D1 = -Z39 * UP1 + Z40 * UP2 + Z41 * UP3 + Z112
a_D2 = -Z40 * UP1 - Z39 * UP2 + Z42 * UP3 + L41 * UP4 + Z113
a_D3 = Z43 * UP1 - Z44 * UP2 + Z114
a_E1 = Z54 * UP1 + Z55 * UP2 + Z56 * UP3 + Z57 * UP4 + Z125
a_E2 = -Z49 * UP1 + Z50 * UP2 + Z126
a_E3 = -Z55 * UP1 + Z54 * UP2 + Z58 * UP3 + Z59 * UP4 + Z127
a_F1 = Z64 * UP1 + Z65 * UP2 + Z66 * UP3 + Z67 * UP4 - L63 * UP5 + Z135
a_F2 = Z68 * UP1 + Z69 * UP2 + Z136
a_F3 = -Z65 * UP1 + Z64 * UP2 + Z58 * UP3 + Z59 * UP4 + Z137
"""

# Weights, from (2.1) to (2.6).
WEIGHTS = """
G_A1 = mA * g * s1
G_A3 = -mA * g * c1
G_B1 = mB * g * s1 * c2
G_B2 = mB * g * c1
G_B3 = -mB * g * s1 * s2
G_C1 = mC * g * (s1 * c2 * c3 + c1 * s3)
G_C2 = mC * g * (c1 * c3 - s1 * c2 * s3)
G_C3 = -mC * g * s1 * s2
G_D1 = mD * g * (s1 * c2 * c34 + c1 * s34)
G_D2 = mD * g * (c1 * c34 - s1 * c2 * s34)
G_D3 = -mD * g * s1 * s2
G_E1 = mE * g * (s1 * c2 * c345 + c1 * s345)
G_E2 = mE * g * s1 * s2
G_E3 = mE * g * (c1 * c345 - s1 * c2 * s345)
G_F1 = mF * g * (s1 * c2 * c345 + c1 * s345)
G_F2 = mF * g * s1 * s2
G_F3 = mF * g * (c1 * c345 - s1 * c2 * s345)
"""

# Angular velocities of the first three links for other generalized speeds, II.2: `first_B1` is the first component of w^B where
# the first link is the base, with the rates of q as speeds; `second_*` where the second is, with w^B . b1, w^B . b2 (Z6, Z7) and
# the rate of q3; `third_*` with those of (2.18).
OTHER_SPEEDS = """
first_B1 = QP1 * s2
second_A2 = Z6 / s2
second_B3 = Z6 / (s2 / c2)
second_C3 = Z6 / (s2 / c2) + QP3
third_B3 = (u1 * c3 - u2 * s3) / (s2 / c2)
"""
