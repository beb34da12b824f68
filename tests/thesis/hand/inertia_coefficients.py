"""Coefficients X_rs of u1', ..., u6' in the generalized inertia forces, Nie 1988, (2.50)-(2.51): minus the mass matrix."""

# As in Appendices 2 and 3, which sum the lower triangle again.
PROGRAMS = """
X11 = Z154 + Z165 + Z174 + Z186 + Z202 + Z219
X12 = Z155 + Z166 + Z187 + Z203 + Z220
X13 = Z175 + Z188 + Z204 + Z221
X14 = Z194 + Z205 + Z222
X15 = Z223
X16 = Z240
X21 = Z159 + Z168 + Z187 + Z203 + Z220
X22 = Z160 + Z169 + Z178 + Z189A + Z207 + Z225
X23 = Z190 + Z208 + Z226
X24 = Z195 + Z209 + Z227
X25 = Z228
X26 = Z241
X31 = Z180 + Z188 + Z204 + Z221
X32 = Z190 + Z208 + Z226
X33 = Z181 + Z192 + Z211 + Z230
X34 = Z196 + Z212 + Z231
X35 = -E2 + Z232
X36 = 0.0
X41 = Z194 + Z205 + Z222
X42 = Z195 + Z209 + Z227
X43 = Z196 + Z212 + Z231
X44 = Z197 + Z214 + Z235
X45 = -E2 + Z236
X46 = 0.0
X51 = Z223
X52 = Z228
X53 = -E2 + Z232
X54 = -E2 + Z236
X55 = -E2 + Z238
X56 = 0.0
X61 = Z240
X62 = Z241
X63 = 0.0
X64 = 0.0
X65 = 0.0
X66 = -F3
"""

# As in Appendix 1, where the lower triangle is that of a symmetric matrix.
APPENDIX_1 = """
X21 = X12
X31 = X13
X32 = X23
X41 = X14
X42 = X24
X43 = X34
X51 = X15
X52 = X25
X53 = X35
X54 = X45
X61 = X16
X62 = X26
X63 = X36
X64 = X46
X65 = X56
"""
