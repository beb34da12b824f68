"""The parts of accelerations without u1', ..., u6', Nie 1988, (2.34)-(2.45) and Appendix 1: Z73 to Z137.

There is no Z123 and no Z124.
"""

# Remainders of the angular accelerations, (2.34)-(2.38), and rates of the coefficients that they are made of.
ANGULAR = """
# A
Z73 = -(s2 * s3 * Z3 + c2 * c3 * Z2) / s2**2
Z74 = (c2 * s3 * Z2 - s2 * c3 * Z3) / s2**2
Z75 = Z73 * u1 + Z74 * u2
# B
Z76 = Z73 * c2 - Z2 * Z4 * s2
Z77 = Z74 * c2 - Z2 * Z5 * s2
Z78 = -(u1 * s3 + u2 * c3) * Z3
Z79 = (u1 * c3 - u2 * s3) * Z3
Z80 = Z76 * u1 + Z77 * u2
# D
Z81 = (c4 * u2 - s4 * u1) * u4
Z82 = -(c4 * u1 + s4 * u2) * u4
# E
Z83 = -s45 * (u4 + u5)
Z84 = c45 * (u4 + u5)
Z85 = Z83 * u1 + Z84 * u2
Z86 = -Z84 * u1 + Z83 * u2
# F
Z87 = Z83 * c6 - Z14 * s6 * u6
Z88 = Z84 * c6 - Z15 * s6 * u6
Z89 = Z83 * s6 + Z14 * c6 * u6
Z90 = Z84 * s6 + Z15 * c6 * u6
Z91 = Z87 * u1 + Z88 * u2 + Z18 * c6 * u6
Z92 = Z89 * u1 + Z90 * u2 + Z18 * s6 * u6
Z93 = -Z84 * u1 + Z83 * u2
"""

# Remainders of the accelerations of the mass centres, (2.40)-(2.45).
LINEAR = """
# A*
Z94 = L13 * (Z73 * u1 + Z74 * u2)
Z95 = -Z1 * Z29
# B*
Z96 = L22 * Z76
Z97 = L22 * Z77
Z98 = L22 * s3 * Z3
Z99 = L22 * c3 * Z3
Z100 = Z96 * u1 + Z97 * u2 + Z7 * Z35
Z101 = Z10 * Z34 - Z6 * Z35
Z102 = Z98 * u1 + Z99 * u2 - Z7 * Z34
# C*
Z103 = Z38 * u2 - Z37 * u3
Z104 = Z36 * u3 - Z38 * u1
Z105 = Z37 * u1 - Z36 * u2
# D*
Z106 = -(L33 + L43) * c4 * u4
Z107 = -(L33 + L43) * s4 * u4
Z108 = L1 * c4 * u4
Z109 = -L1 * s4 * u4
Z110 = L41 * c4 * u4
Z111 = -L41 * s4 * u4
Z112 = Z106 * u1 + Z107 * u2 + Z108 * u3 + (Z12 * Z47 - Z13 * Z46)
Z113 = -Z107 * u1 + Z106 * u2 + Z109 * u3 + (Z13 * Z45 - Z11 * Z47)
Z114 = Z110 * u1 - Z111 * u2 + (Z11 * Z46 - Z12 * Z45)
# E*
Z115 = Z84 * Z51 - (L33 + L43) * (u4 + u5) * c45
Z116 = -Z83 * Z51 + (Z107 - Z39 * u5) * c5 - (-Z106 + Z40 * u5) * s5
Z117 = L1 * c45 * (u4 + u5) + L2 * c5 * u5
Z118 = L2 * c5 * u5
Z119 = L2 * c4 * u4
Z120 = -L2 * s4 * u4
Z121 = -L1 * s4 * c5 * u4 - Z48 * s5 * u5 - Z108 * s5 - Z41 * c5 * u5
Z122 = -L2 * s5 * u5
Z125 = Z115 * u1 + Z116 * u2 + Z117 * u3 + Z118 * u4 + Z18 * Z62 - Z19 * Z61
Z126 = -Z119 * u1 + Z120 * u2 + Z19 * Z60 - Z17 * Z62
Z127 = -Z116 * u1 + Z115 * u2 + Z121 * u3 + Z122 * u4 + Z17 * Z61 - Z18 * Z60
# F*
Z128 = Z84 * Z63 - (L33 + L43) * (u4 + u5) * c45
Z129 = -Z83 * Z63 + (Z107 - Z39 * u5) * c5 - (-Z106 + Z40 * u5) * s5
Z130 = -Z119 - L63 * Z83
Z131 = Z120 - L63 * Z84
Z132 = Z18 * Z72 - Z19 * Z71
Z133 = Z19 * Z70 - Z17 * Z72
Z134 = Z17 * Z71 - Z18 * Z70
Z135 = Z128 * u1 + Z129 * u2 + Z117 * u3 + Z118 * u4 + Z132
Z136 = Z130 * u1 + Z131 * u2 + Z133
Z137 = -Z129 * u1 + Z128 * u2 + Z121 * u3 + Z122 * u4 + Z134
"""
