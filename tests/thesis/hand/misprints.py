"""Misprints of Nie 1988 whose printed form can be evaluated: equations as printed, by place.

The lists of equations have the correct forms, and experiments/errata.md says what each misprint costs.
"""

# Of equations that torques depend on.
PROGRAMS = {
    "Appendix 1: Z74": {"Z74": "(c2 * s2 * Z2 - s2 * c3 * Z3) / s2**2"},
    "Appendix 2: UP2": {"UP2": "-QDP1 * s2 * s3 + QP1 * QP2 * c2 * s3 + QP1 * QP3 * s2 * c3 + QDP2 * c3 - QP2 * QP3 * s3"},
    "Appendix 2: Z73": {"Z73": "-(((s2 * s3 * Z3 + c2 * c3 * Z2) / s2) ** 2)"},
    "Appendix 2: Z79": {"Z79": "-(u1 * c3 - u2 * s3) * Z3"},
    "Appendix 2: Z116": {"Z116": "-Z83 * Z51 + (Z107 - Z39 * u5) * c5 - (Z106 + Z40 * u5) * s5"},
    "Appendix 2: Z125": {"Z125": "Z115 * u1 + Z116 * u2 + Z117 * u3 + Z118 * u4 + Z118 * Z62 - Z19 * Z61"},
    "Appendix 2: Z166": {"Z166": "-(B1 * c3 * s3 + B2 * c3 * s3 + B3 * Z8 * Z9 + mB * Z30 * Z31 + mB * Z32 * Z33)"},
    "Appendix 2: Z168": {"Z168": "-(B1 * s3 * c3 + B2 * c3 * s3 + B3 * Z8 * Z9 + mB * Z30 * Z31 + mB * Z32 * Z33)"},
    "Appendix 2: Z170": {
        "Z170": "-(B1 * s3 * Z78 - Z162 * s3 + B2 * c3 * Z79 + Z163 * c3 + B3 * Z9 * Z80 + Z164 * Z9"
        " + mB * Z31 * Z100 + mB * Z33 * Z102)"
    },
    "Appendix 3: Z165": {"Z165": "-(-B1 * c3**2 + B2 * s3**2 + B3 * Z8**2 + mB * Z30**2 + mB * Z32**2)"},
    "Appendix 3: Z167": {
        "Z167": "-(-Z162 * c3 + Z163 * s3 + Z164 * Z8 + B1 * c3 * Z78 + B2 * s3 * Z79 + B3 * Z8 * Z80"
        " + mB * Z30 * Z100 + mB * Z32 * Z102)"
    },
    "Appendix 3: Z169": {"Z169": "-(-B1 * s3**2 + B2 * c3**2 + B3 * Z9**2 + mB * Z31**2 + mB * Z33**2)"},
    "Appendix 3: Z186": {"Z186": "-(-D1 * c4**2 + D2 * s4**2 + mD * (Z39**2 + Z40**2 + Z43**2))"},
    "Appendix 3: Z272": {"Z272": "mE * (Z54 * Z269 - Z49 * Z270 + Z55 * Z271)"},
}

# Of vectors and of other equations in chapter II.
TEXT = {
    "II.2, first link as base: w^2": {"first_B1": "QP2 * s1"},
    "II.2, second link as base: w^1": {"second_A2": "s2 * Z6"},
    "II.2, second link as base: w^2": {"second_B3": "QP3"},
    "II.2, second link as base: w^3": {"second_C3": "Z6 * (s2 / c2) + QP3"},
    "II.2, third link as base: w^2": {"third_B3": "(u1 * c3 - u2 * s3) * (s2 / c2)"},
    "before (2.31): v^P": {"v_P2": "L31 * u3 - L33 * u1"},
    "(2.31): v^D*": {"v_D2": "-Z40 * u1 - Z39 * u2 + Z42 * u3 + Z41 * u4"},
    "Table 1: w1^E": {"w1_E3": "-Z16"},
    "Table 2: v1^B*": {"v1_B3": "Z31 + Z8"},
    "Table 2: v2^B*": {"v2_B3": "Z33 + Z9"},
    "Table 2: v1^C*": {"v1_C1": "-L33", "v1_C2": "0"},
    "Table 2: v1^F*": {"v1_F3": "-Z55"},
    "Table 2: v2^F*": {"v2_F3": "Z54"},
    "(2.38): alpha^F, f1": {"alpha_F1": "Z20 * UP1 + Z21 * UP2 - s6 * (UP3 + UP4 + UP5)"},
    "(2.38): alpha^F, f2": {"alpha_F2": "-(Z22 * UP1 + Z23 * UP2 + c6 * (UP3 + UP4 + UP5))"},
    "(2.38): alpha^F, f3": {"alpha_F3": "s3 * UP1 + c3 * UP2 + Z79"},
    "before (2.40): w^A x v^A*": {"a_A3": "-Z12 * Z29"},
    "(2.42): a^C*, c1": {"a_C1": "L33 * UP2 + Z102"},
    "(2.42): a^C*, c3": {"a_C3": "-L31 * UP1 + Z105"},
    "II.4: (k1*)_C": {"KI1_C": "Z174 * UP1 + Z175 * UP2 + Z176"},
    "II.4: (k3*)_C": {"KI3_C": "Z180 * UP1 + Z181 * UP2 + Z182"},
    "II.4: (k4*)_F": {"KI4_F": "Z222 * UP1 + Z227 * UP2 + Z231 * UP3 + Z235 * UP4 + Z226 * UP5 + Z237"},
    "II.5: G_C, c2": {"G_C2": "mC * g * (c1 * c3 - s1 * c2)"},
    "(2.58), row 6": {"RHS6": "-T6 - Z241"},
}
