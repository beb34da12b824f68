"""Nie's derivation by hand of the equations of motion of the Intelledex 605, as he printed it: an oracle for the library.

Everything here comes from the printed equations of Nie 1988 (chapter II, Appendices 1 to 3, Table 3) and none of it from the
library's recursions. The equations are lists of text, with the misprints corrected; `misprints` has the printed forms.
"""
