"""The methods of integration that files and commands know by name."""

from collections.abc import Callable
from typing import Any

import diffrax

from kanejax._simulate.beta_scheme import BetaScheme

SOLVERS: dict[str, Callable[[], diffrax.AbstractSolver[Any]]] = {
    "euler": diffrax.Euler,
    "heun": diffrax.Heun,
    "midpoint": diffrax.Midpoint,
    "ralston": diffrax.Ralston,
    "bosh3": diffrax.Bosh3,
    "tsit5": diffrax.Tsit5,
    "dopri5": diffrax.Dopri5,
    "dopri8": diffrax.Dopri8,
    "implicit-euler": diffrax.ImplicitEuler,
    "implicit-midpoint": BetaScheme,
    "kvaerno3": diffrax.Kvaerno3,
    "kvaerno4": diffrax.Kvaerno4,
    "kvaerno5": diffrax.Kvaerno5,
}
