"""Angular velocities and velocities of the mass centres, Nie 1988, (2.20)-(2.32) and Appendix 1, Z1 to Z72."""

# Rates of the coordinates, and components of the angular velocities of links A to F, each in its own frame, (2.20)-(2.25).
ANGULAR = """
# coordinate rates
Z1 = (u1 * c3 - u2 * s3) / s2
Z2 = -u1 * s3 - u2 * c3
Z3 = u3 + (u2 * s3 - u1 * c3) * c2 / s2
# A
Z4 = c3 / s2
Z5 = -s3 / s2
# B
Z6 = u1 * c3 - u2 * s3
Z7 = -Z2
Z8 = Z4 * c2
Z9 = Z5 * c2
Z10 = Z8 * u1 + Z9 * u2
# D
Z11 = u1 * c4 + u2 * s4
Z12 = -u1 * s4 + u2 * c4
Z13 = u3 + u4
# E
Z14 = c45
Z15 = s45
Z16 = -Z15
Z17 = u1 * Z14 + u2 * Z15
Z18 = -Z13 - u5
Z19 = u1 * Z16 + u2 * Z14
# F
Z20 = Z14 * c6
Z21 = Z15 * c6
Z22 = Z14 * s6
Z23 = Z15 * s6
Z24 = Z20 * u1 + Z21 * u2 + Z18 * s6
Z25 = -Z22 * u1 - Z23 * u2 + Z18 * c6
Z26 = Z16 * u1 + Z14 * u2 + u6
"""

# Coefficients and components of the velocities of the mass centres, (2.27)-(2.32); that of F in the frame of E.
LINEAR = """
# A*
Z27 = L13 * Z4
Z28 = L13 * Z5
Z29 = Z27 * u1 + Z28 * u2
# B*
Z30 = L22 * Z8
Z31 = L22 * Z9
Z32 = -L22 * c3
Z33 = L22 * s3
Z34 = Z30 * u1 + Z31 * u2
Z35 = Z32 * u1 + Z33 * u2
# C*
Z36 = L33 * u2
Z37 = L31 * u3 - L33 * u1
Z38 = -L31 * u2
# D*
Z39 = (L33 + L43) * s4
Z40 = (L33 + L43) * c4
Z41 = L1 * s4
Z42 = L1 * c4 + L41
Z43 = L41 * s4
Z44 = L1 + L41 * c4
Z45 = -Z39 * u1 + Z40 * u2 + Z41 * u3
Z46 = -Z40 * u1 - Z39 * u2 + Z42 * u3 + L41 * u4
Z47 = Z43 * u1 - Z44 * u2
# E*
Z48 = L1 * c4 + L2
Z49 = L2 * s4
Z50 = L1 + L2 * c4
Z51 = L33 + L43 - L52
Z52 = Z39 * c5 + Z40 * s5
Z53 = Z40 * c5 - Z39 * s5
Z54 = Z15 * Z51 - Z52
Z55 = Z53 - Z14 * Z51
Z56 = Z41 * c5 + Z48 * s5
Z57 = L2 * s5
Z58 = Z48 * c5 - Z41 * s5
Z59 = L2 * c5
Z60 = Z54 * u1 + Z55 * u2 + Z56 * u3 + Z57 * u4
Z61 = -Z49 * u1 + Z50 * u2
Z62 = -Z55 * u1 + Z54 * u2 + Z58 * u3 + Z59 * u4
# F*
Z63 = L33 + L43
Z64 = Z15 * Z63 - Z52
Z65 = Z53 - Z14 * Z63
Z66 = Z56 - L63
Z67 = Z57 - L63
Z68 = -Z49 - L63 * Z14
Z69 = Z50 - L63 * Z15
Z70 = Z64 * u1 + Z65 * u2 + Z66 * u3 + Z67 * u4 - L63 * u5
Z71 = Z68 * u1 + Z69 * u2
Z72 = -Z65 * u1 + Z64 * u2 + Z58 * u3 + Z59 * u4
"""
