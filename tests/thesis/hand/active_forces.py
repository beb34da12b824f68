"""Generalized active forces of gravity, Nie 1988, II.5 and Appendix 1, Z251 to Z285.

There is no Z249 and no Z250.
"""

# Weights in the frames of the links, and what they contribute to the generalized active forces k1 to k5.
GRAVITY = """
# A
Z251 = mA * s1
Z252 = Z251 * Z27
Z253 = Z251 * Z28
# B
Z254 = mB * s1 * c2
Z255 = -mB * s1 * s2
Z256 = Z30 * Z254 + Z32 * Z255
Z257 = Z31 * Z254 + Z33 * Z255
# C
Z258 = c1 * c3 - s1 * c2 * s3
Z259 = -mC * L33 * Z258
Z260 = mC * (L33 * (s1 * c2 * c3 + c1 * s3) + L31 * s1 * s2)
Z261 = mC * L31 * Z258
# D
Z262 = s1 * c2 * c34 + c1 * s34
Z263 = c1 * c34 - s1 * c2 * s34
Z264 = -s1 * s2
Z265 = -mD * (Z39 * Z262 + Z40 * Z263 - Z43 * Z264)
Z266 = mD * (Z40 * Z262 - Z39 * Z263 - Z44 * Z264)
Z267 = mD * (Z41 * Z262 + Z42 * Z263)
Z268 = mD * L41 * Z263
# E
Z269 = s1 * c2 * c345 + c1 * s345
Z270 = s1 * s2
Z271 = c1 * c345 - s1 * c2 * s345
Z272 = mE * (Z54 * Z269 - Z49 * Z270 - Z55 * Z271)
Z273 = mE * (Z55 * Z269 + Z50 * Z270 + Z54 * Z271)
Z274 = mE * (Z56 * Z269 + Z58 * Z271)
Z275 = mE * (Z57 * Z269 + Z59 * Z271)
# F
Z276 = mF * (Z64 * Z269 + Z68 * Z270 - Z65 * Z271)
Z277 = mF * (Z65 * Z269 + Z69 * Z270 + Z64 * Z271)
Z278 = mF * (Z66 * Z269 + Z58 * Z271)
Z279 = mF * (Z67 * Z269 + Z59 * Z271)
Z280 = -mF * L63 * Z269
# sums
Z281 = g * (Z252 + Z256 + Z259 + Z265 + Z272 + Z276)
Z282 = g * (Z253 + Z257 + Z260 + Z266 + Z273 + Z277)
Z283 = g * (Z261 + Z267 + Z274 + Z278)
Z284 = g * (Z268 + Z275 + Z279)
Z285 = g * Z280
"""
