"""Glider kinematics: constant speed through water along a heading and a glide angle, and the step that integrates it.

The text is the same for NumPy arrays and CasADi expressions, so that the optimiser and the check of its answer cannot drift apart.
"""

from collections.abc import Callable
from typing import Any


def velocity_through_water(maths: Any, heading: Any, glide_angle: Any, speed: Any) -> tuple[Any, Any, Any]:
    """Return the velocity through water [m/s] as (east, north, down) in the frame that the heading refers to.

    Args:
        maths: ``numpy`` or ``casadi``: where sine and cosine come from.
        heading: Clockwise from north [rad].
        glide_angle: Below the horizontal, positive down [rad].
        speed: Through water [m/s].
    """
    horizontal = speed * maths.cos(glide_angle)
    return horizontal * maths.sin(heading), horizontal * maths.cos(heading), speed * maths.sin(glide_angle)


def euler_step(rate: Callable[[Any], Any], position: Any, step: Any, first: Any) -> Any:
    """Return the position one step of Euler's later, as in Kong et al. (IROS 2021); arguments as for ``rk4_step``."""
    return position + step * first


def rk4_step(rate: Callable[[Any], Any], position: Any, step: Any, first: Any) -> Any:
    """Return the position one classical Runge-Kutta step later.

    Args:
        rate: Velocity over ground at a position.
        position: Where the step begins; a vector or a stack of them.
        step: Length of the step [s], a scalar or one that broadcasts against the positions.
        first: ``rate(position)``, which the caller often needs too.
    """
    second = rate(position + step / 2.0 * first)
    third = rate(position + step / 2.0 * second)
    fourth = rate(position + step * third)
    return position + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
