"""``[gating]``, ``[consistency]``, ``[time]``: gate, consistency checks, and change of the estimate in time."""

from typing import Annotated, Literal

from pydantic import Field

from replay_kit.config.file import NotNegative, Positive, Section
from replay_kit.config.option import Option


class GatingConfig(Section):
    """``[gating]``: the gate; the paper preset uses none.

    Attributes:
        gate: Treatment of a profile that exceeds the gate; off also takes all errors as stated.
        gate_probability: Probability that a profile with sound errors exceeds the gate.
    """

    gate: Literal["reject", "off"] = "reject"
    gate_probability: Annotated[float, Field(gt=0.0, lt=0.5)] = 1e-5


class ConsistencyConfig(Section):
    """``[consistency]``: the checks of sensors and labels during a replay.

    Attributes:
        on_failure: When sources contradict each other: report goes on without what is wrong and ends with exit code 6, stop ends with
            3, ignore checks nothing.
    """

    on_failure: Literal["report", "stop", "ignore"] = "report"


Oscillation = Literal["inertial", "M2", "S2", "K1", "O1"]
Bias = Literal["heading", "scale", "shear"]


class TimeConfig(Section):
    """``[time]``: change of the current in time, oscillations, and biases of the instrument.

    Attributes:
        scale: Decorrelation time of the forecast error [s]; auto: the ensemble's between its times, 20 days with one; static: none.
        window: Time within which profiles that repeat each other are combined [s], for logs of 1 to 10 Hz; 0: none;
            auto: by the current's change.
        oscillators: Oscillations uniform over the region with their own depth structure: inertial, M2, S2, K1, O1.
        biases: Instrument errors to estimate: heading, scale, shear.
    """

    scale: Annotated[
        Literal["auto", "static"] | Positive, Option("S|auto|static", name="--time-scale")
    ] = "auto"
    window: Literal["auto"] | NotNegative = "auto"
    oscillators: Annotated[tuple[Oscillation, ...], Option("O1,O2,...")] = ()

    biases: tuple[Bias, ...] = ()
