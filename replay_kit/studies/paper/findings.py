"""The findings of the study: its tables in words with their numbers."""

from collections.abc import Mapping, Sequence

import numpy as np

from replay_kit.core.text import count_text
from replay_kit.studies.jobs import bootstrap_ratio
from replay_kit.studies.paper.rows import ErrorRow, SparseRow
from replay_kit.studies.paper.run import PaperTables
from replay_kit.studies.reports.page import AVERAGED, LABELS, TRUTH
from replay_kit.studies.reports.tables import grouped, number

# Cases from which an interval of 90 % decides a comparison: of four not even all on one side are that unlikely by chance.
_LEAST_CASES = 5


def conditions(tables: PaperTables) -> str:
    """Return what the study was made on."""
    rows, columns = tables.grid
    levels = ", ".join(f"{level:.4g}" for level in tables.levels)
    turns = f"Each of the {tables.truths} members is the truth in turn in Tables I and II: medians, and the worst truth. "
    modes = "all modes" if tables.plan_modes is None else f"at most {tables.plan_modes} modes"
    return (
        f"{tables.members} members of `{tables.ensemble}` on {rows} x {columns} points and levels {levels} m; truth `{tables.truth}`; seed "
        f"{tables.seed}. {turns if tables.truths > 1 else ''}Table III shows truth `{tables.shown_truth}`; plans are made "
        f"on the estimates after Table II's last ping, with {modes}. Relative error: RMSE over the RMS speed of the truth, over all "
        "wet grid points. Bound: the least-squares fit of the truth within a method's span. Elements in H: two for each mode and node, of "
        "whole flows for each level too, of `default` one for each mode and point of its lattice. `paper` and the naive basis take "
        "R = (0.01 m/s)^2 in Table I and (0.12 m/s)^2 in Table II for every bin; `default` takes the bins' own error, 0.01 and "
        f"{tables.noise:g} m/s, and adds what its basis leaves of members that are shifted by a correlation length, at the profile's place."
    )


def sparse_logs(tables: PaperTables) -> tuple[str, ...]:
    """Return how the paper's estimator compares on sparse logs, then why it fails, a paragraph each."""
    kernel = tables.depth_kernel
    low, high = tables.level_correlation
    return (
        _against_mean(tables.sparse),
        f"*Diagonal prior.* The members' anomalies at neighbouring levels correlate {low:.2f} to {high:.2f}. The paper's prior keeps the "
        "variances of the weights alone and ignores this; the prior of `default` has covariances between depths. "
        "It also takes the strength of the ensemble mean, which its flow has whole, as uncertain.",
        f"*Gaussians in depth.* With l_z = {kernel.length:g} m their matrix on these levels has condition {kernel.condition:.1e}, and a "
        f"current of 1 m/s at all depths is fitted as {kernel.least_share:.2f} m/s at {kernel.least_depth:.0f} m and "
        f"{kernel.largest_share:.2f} m/s at {kernel.largest_depth:.0f} m. Where levels are closer than l_z the matrix is nearly singular: "
        "a smooth profile needs large latents of opposite sign, which a prior of independent variances does not keep together. "
        "Where levels are farther apart the field sags between them. Hats (`default`) return such a current exactly.",
        _ordering(tables.table1),
    )


def errors(tables: PaperTables) -> str:
    """Return how every estimator's errors in Tables I and II compare with those of the default, each with as many modes as it may have."""
    said = []
    for name, rows in (("I", tables.table1), ("II", tables.table2)):
        errors: dict[str, Sequence[float]] = {}
        for row in rows:
            if np.isfinite(row.rel_error):
                errors.setdefault(row.method, row.rel_error_by_truth)
        if "default" in errors:
            said.append(f"*Table {name}.* {_of_truths(errors)}")
    return " ".join(said)


def glides(tables: PaperTables) -> str:
    """Return how the plans on every flow compare in Table III with those on the depth-averaged truth and on the default, and why."""
    ranked = sorted((row for row in tables.table3 if not row.note), key=lambda row: row.median)
    average = next(row for row in ranked if row.flow == AVERAGED)
    listed = ", ".join(
        f"{LABELS[row.flow]} {number(row.median, 0)} m ({row.within_250})"
        for row in ranked
        if row.flow not in (TRUTH, AVERAGED)
    )
    misses = {row.flow: row.closest_approach for row in ranked if row.flow != TRUTH}
    near = f"{average.within_250} of {average.pairs} within 250 m"
    carried = f"{100.0 * tables.coherence:.0f} % of this truth's mean squared speed down to {tables.target_depth:g} m"
    return (
        f"The depth-averaged truth passes the targets at a median of {number(average.median, 0)} m, {near}; the estimates: {listed}. "
        f"{_of_pairs(misses)} The average carries {carried}. A glide at one vertical speed spends the same time at every depth, so the "
        "average gives the whole drift of a current that does not change along the path, however it changes with depth. What it misses is "
        "that the glide meets the upper current in one place and the lower one in another: little where the current is coherent in depth, "
        "or wide against the glide. It also knows the truth, which an estimate has to infer from pings."
    )


def _of_pairs(misses: Mapping[str, Sequence[float]]) -> str:
    """Return which flows' plans come nearer to their targets than those on the average and on the default, or that this is not known."""
    pairs = len(misses[AVERAGED])
    if pairs < _LEAST_CASES:
        return f"{count_text(pairs, 'pair')} of start and target are too few to tell which plans come nearer: it takes {_LEAST_CASES}."
    known = [one for one in (AVERAGED, "default") if one in misses]
    sides = {LABELS[one]: _sides(misses, one, "nearer", "farther") for one in known}
    of_what = f"by the 90 % interval of the ratio of medians over {pairs} pairs"
    return " ".join(
        f"Beside plans on the {label}, {of_what}: {said}." for label, said in sides.items()
    )


def _of_truths(errors: Mapping[str, Sequence[float]]) -> str:
    """Return whose errors are smaller and larger than the default's: over some truths by intervals, over few as they are."""
    truths, label = len(errors["default"]), LABELS["default"]
    if truths >= _LEAST_CASES:
        sides = _sides(errors, "default", "smaller", "larger")
        return f"Beside {label}, by the 90 % interval of the ratio of medians over {truths} truths: {sides}."
    medians = {method: float(np.median(values)) for method, values in errors.items()}
    smaller, larger = (
        [
            f"{LABELS[method]} ({number(value)})"
            for method, value in medians.items()
            if sign * (medians["default"] - value) > 0.0
        ]
        for sign in (1.0, -1.0)
    )
    return (
        f"On {count_text(truths, 'truth')} the relative error of {label} is {number(medians['default'])}; smaller: {_listed(smaller)}; "
        f"larger: {_listed(larger)}. So few truths tell nothing of others: it takes {_LEAST_CASES} (--leave-out all)."
    )


def _sides(values: Mapping[str, Sequence[float]], reference: str, below: str, above: str) -> str:
    """Return which medians are certainly below and above a reference's, by intervals over the same cases, and which cannot be told."""
    sides: dict[str, list[str]] = {below: [], above: [], "cannot be told": []}
    for name, of_name in values.items():
        if name != reference:
            low, high = _interval(of_name, values[reference])
            sides[below if high < 1.0 else above if low > 1.0 else "cannot be told"].append(
                LABELS[name]
            )
    return "; ".join(f"{side}: {_listed(names)}" for side, names in sides.items())


def _interval(values: Sequence[float], others: Sequence[float]) -> tuple[float, float]:
    """Return the ends of the interval of the ratio of two medians over the same cases; NaN where a case lacks one of them."""
    if len(values) != len(others) or not np.isfinite([*values, *others]).all():
        return np.nan, np.nan
    return bootstrap_ratio(np.array(values), np.array(others))


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"


def _against_mean(rows: Sequence[SparseRow]) -> str:
    of_method = {
        method: {row.pings: row for row in rows if row.method == method}
        for method in ("ensemble_mean", "default")
    }
    mean, default = of_method["ensemble_mean"], of_method["default"]
    truths = max(len(row.rel_error_by_truth) for row in rows)
    to_mean, to_default = [], []
    for method in ("paper", "paper_cells", "default"):
        alike = [row for row in rows if row.method == method]
        if not alike:
            continue
        sides = {row.pings: _side_of_mean(row, mean[row.pings]) for row in alike}
        listed = {
            side: ", ".join(
                f"{row.pings} pings ({number(row.rel_error)} against {number(mean[row.pings].rel_error)})"
                for row in alike
                if sides[row.pings] == side
            )
            for side in ("worse than", "not told apart from")
        }
        parts = [f"{side} the ensemble mean at {cases}" for side, cases in listed.items() if cases]
        to_mean.append(f"{LABELS[method]}: {', '.join(parts) or 'better than the ensemble mean'}")
        times = [row.rel_error / default[row.pings].rel_error for row in alike]
        to_default += (
            [f"{LABELS[method]} {number(min(times), 1)} to {number(max(times), 1)} times"]
            if method != "default"
            else []
        )
    over = (
        f"Over {truths} truths"
        if truths >= _LEAST_CASES
        else f"On {count_text(truths, 'truth')}, too few to tell of others"
    )
    return f"{over}: {'; '.join(to_mean)}. Error over that of {LABELS['default']} at the same count: {', '.join(to_default)}."


def _side_of_mean(row: SparseRow, mean: SparseRow) -> str:
    """Return how an error compares with the ensemble mean's: by the interval over truths, of few truths by the medians."""
    if len(row.rel_error_by_truth) < _LEAST_CASES:
        return "better than" if row.rel_error < mean.rel_error else "worse than"
    low, high = _interval(row.rel_error_by_truth, mean.rel_error_by_truth)
    return "better than" if high < 1.0 else "worse than" if low > 1.0 else "not told apart from"


def _ordering(rows: Sequence[ErrorRow]) -> str:
    bounds = grouped((row for row in rows if row.rung), lambda row: row.method)
    listed = "; ".join(
        f"{LABELS[method]}: {', '.join(f'{number(row.bound, 4)} m/s with {row.modes}' for row in alike)}"
        for method, alike in bounds.items()
    )
    return (
        "*Order of the modes.* Latents are velocities divided by the kernel's eigenvalues, in depth and in the horizontal, so their SVD "
        "puts first the components that the smallest eigenvalues amplify; the SVD of velocities orders by the flow. The least RMSE "
        f"that any weights could give (bound): {listed}.{_nearer_spans(rows)}"
    )


def _nearer_spans(rows: Sequence[ErrorRow]) -> str:
    """Return where the paper's modes span the truth better than as many of the default's, so that their order explains no error."""
    default = {row.modes: row.bound for row in rows if row.rung and row.method == "default"}
    nearer = [
        str(row.modes)
        for row in rows
        if row.rung and row.method == "paper" and row.bound < default.get(row.modes, 0.0)
    ]
    if not nearer:
        return ""
    return f" With {', '.join(nearer)} modes {LABELS['paper']} is the nearer to this truth: there the order explains no error."
