"""Settings, options and values removed since earlier versions, each with its replacement."""

from replay_kit.core.errors import ConfigError

_SAMPLING = "without adaptive sampling, choose the places yourself, and plan to them with --goal"
_BLIND = "it assumed that headings are held: see --held"
_CONSTANT = "its default now always applies"
_GATE = "what exceeds the gate is rejected: softening let faults in"

#: Keys of the settings, by table; of a table with a command's name they are its options too.
SETTINGS: dict[str, dict[str, str]] = {
    "measurements": {
        "use_dac": 'without = ["dac"] leaves depth-averaged currents out',
        **dict.fromkeys(
            ("use_drift", "drift_std", "drift_depth"),
            "drift between fixes is not used: the wind moves the vehicle too",
        ),
    },
    "measurements.map": {"join_within": "record both components of a velocity in one message"},
    "forecast": {"level_step": "name the levels, as in levels = [0, 100, 300]"},
    "gating": {
        "soften_factor": _GATE,
        "adapt_errors": 'errors are always adapted to the scatter of a profile; gate = "off" takes them as stated',
        **dict.fromkeys(
            ("inflate", "inflation_profiles"),
            "an ensemble that differs too little is found by its first profiles, and its variance multiplied",
        ),
    },
    "measurements.quality": dict.fromkeys(("outlier_window", "outlier_floor"), _CONSTANT),
    "time": {
        "dropped_std": "it is [estimator] dropped_std, also for a static estimate",
        **dict.fromkeys(
            (
                "trajectory_scale",
                "oscillator_std",
                "oscillator_scale",
                "oscillator_depth_length",
                "heading_bias_std",
                "scale_bias_std",
                "shear_bias_std",
            ),
            _CONSTANT,
        ),
    },
    "replay": {"truth_radius": "all points of the truth are scored"},
    "twin": dict.fromkeys(("interval", "changing"), "pings come every ten minutes"),
    "planner": {"flight_model": "a script plans with Glider(flight=fit_flight(...))"},
    "plan": {
        **dict.fromkeys(
            ("then", "blind", "survey", "box", "profiles", "profile_error", "others"), _SAMPLING
        ),
        "policy": _BLIND,
        "spline": "plans are always flown and checked in the estimate itself",
    },
}
#: Values of an option.
VALUES: dict[str, dict[str, str]] = {
    "gating.gate": {"soften": _GATE},
    "--without": {"drift": "leave it out; no drift between fixes is used"},
    "--oscillators": {"steady": "closer levels resolve depth more finely"},
    "--objective": dict.fromkeys(("learn", "map"), _SAMPLING),
    "--estimator": dict.fromkeys(
        ("ensemble_mean", "etkf", "letkf", "gp", "depth_average"),
        "leave it out for the project's own, or add yours as a package (entry point replay_kit.estimators)",
    ),
}


def instead_of(command: str, option: str) -> str:
    """Return the replacement of a removed option of a command; empty for an unknown option."""
    return SETTINGS.get(command, {}).get(option.replace("-", "_"), "")


def refuse_value(option: str, value: object) -> None:
    """Raise ConfigError for a removed value of an option."""
    if (instead := VALUES.get(option, {}).get(str(value))) is not None:
        raise ConfigError(f"{option} has no {value} any more: {instead}")
