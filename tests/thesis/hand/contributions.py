"""Contributions of each link to the generalized inertia forces, Nie 1988, II.4, and right sides of the equations of motion."""

# KI3_C is the contribution of link C to k3*.
LINKS = """
KI1_A = Z154 * UP1 + Z155 * UP2 + Z156
KI2_A = Z159 * UP1 + Z160 * UP2 + Z161
KI1_B = Z165 * UP1 + Z166 * UP2 + Z167
KI2_B = Z168 * UP1 + Z169 * UP2 + Z170
KI1_C = Z174 * UP1 + Z175 * UP3 + Z176
KI2_C = Z178 * UP2 + Z179
KI3_C = Z180 * UP1 + Z181 * UP3 + Z182
KI1_D = Z186 * UP1 + Z187 * UP2 + Z188 * UP3 + Z194 * UP4 + Z189
KI2_D = Z187 * UP1 + Z189A * UP2 + Z190 * UP3 + Z195 * UP4 + Z191
KI3_D = Z188 * UP1 + Z190 * UP2 + Z192 * UP3 + Z196 * UP4 + Z193
KI4_D = Z194 * UP1 + Z195 * UP2 + Z196 * UP3 + Z197 * UP4 + Z198
KI1_E = Z202 * UP1 + Z203 * UP2 + Z204 * UP3 + Z205 * UP4 + Z206
KI2_E = Z203 * UP1 + Z207 * UP2 + Z208 * UP3 + Z209 * UP4 + Z210
KI3_E = Z204 * UP1 + Z208 * UP2 + Z211 * UP3 + Z212 * UP4 - E2 * UP5 + Z213
KI4_E = Z205 * UP1 + Z209 * UP2 + Z212 * UP3 + Z214 * UP4 - E2 * UP5 + Z215
KI5_E = -E2 * (UP3 + UP4 + UP5) + Z200
KI1_F = Z219 * UP1 + Z220 * UP2 + Z221 * UP3 + Z222 * UP4 + Z223 * UP5 + Z240 * UP6 + Z224
KI2_F = Z220 * UP1 + Z225 * UP2 + Z226 * UP3 + Z227 * UP4 + Z228 * UP5 + Z241 * UP6 + Z229
KI3_F = Z221 * UP1 + Z226 * UP2 + Z230 * UP3 + Z231 * UP4 + Z232 * UP5 + Z234
KI4_F = Z222 * UP1 + Z227 * UP2 + Z231 * UP3 + Z235 * UP4 + Z236 * UP5 + Z237
KI5_F = Z223 * UP1 + Z228 * UP2 + Z232 * UP3 + Z236 * UP4 + Z238 * UP5 + Z239
KI6_F = Z240 * UP1 + Z241 * UP2 - F3 * UP6 + Z242
"""

# Right sides of (2.58), which stand opposite the sums of X_rs u_s'.
RIGHT_SIDES = """
RHS1 = -Z4 * T1 + s3 * T2 + Z8 * T3 - Z281 - Z243
RHS2 = -Z5 * T1 + c3 * T2 + Z9 * T3 - Z282 - Z244
RHS3 = -T3 - Z283 - Z245
RHS4 = -T4 - Z284 - Z246
RHS5 = -T5 - Z285 - Z247
RHS6 = -T6 - Z248
"""
