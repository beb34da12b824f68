"""What ends a simulation in chosen speeds before they cease to determine the motion."""

from typing import Any, final

import equinox as eqx
import jax

from kanejax._kinematics.change_of_speeds import check_regular, speed_conditioning
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds
from kanejax._simulate.events import Falling, JointLimitBounce

SINGULAR_SPEEDS = "singular speeds"
# Of the first state's conditioning; from the state there, the model's own speeds still follow with three digits less.
TOO_LITTLE = 1e-3


def add_singularity(
    model: AnyModel, t0: jax.Array, q0: jax.Array, conditions: tuple[Falling, ...], names: tuple[str, ...]
) -> tuple[tuple[Falling, ...], tuple[str, ...]]:
    """Conditions and names, with one more at the end if speeds were chosen: where these cease to determine the motion.

    Integration leaps over such a place, but the errors of the speeds are divided by zero there.

    Raises:
        ValueError: they do not determine the motion at the first state.
    """
    if not isinstance(model, WithSpeeds):
        return conditions, names
    check_regular(model.at(t0), q0, "q0")
    regularity = _Regularity(model, speed_conditioning(model.at(t0), q0))
    return (*conditions, Falling(regularity, 1, model.tree)), (*names, SINGULAR_SPEEDS)


def check_bounce(model: AnyModel, on_event: Any) -> None:
    """Check that a bounce reads the speeds as the simulation does.

    Raises:
        ValueError: one has chosen speeds, and the other has not.
    """
    if isinstance(on_event, JointLimitBounce) and isinstance(on_event.model, WithSpeeds) != isinstance(model, WithSpeeds):
        raise ValueError("the speeds of JointLimitBounce's model are not those of the simulated one; give it the same model")


@final
class _Regularity(eqx.Module):
    """Conditioning of the chosen speeds, relative to that of the first state, less what is too little."""

    model: WithSpeeds
    first: jax.Array

    def __call__(self, t: jax.Array, q: jax.Array, u: jax.Array) -> jax.Array:
        return speed_conditioning(self.model.at(t), q) / self.first - TOO_LITTLE
