"""The findings of the study: its tables in words with their numbers."""

from collections.abc import Sequence

from replay_kit.studies.paper.rows import ErrorRow, SparseRow
from replay_kit.studies.paper.run import PaperTables
from replay_kit.studies.reports.flows import AVERAGED, LABELS, TRUTH
from replay_kit.studies.reports.write import number


def conditions(tables: PaperTables) -> str:
    """Return what the study was made on."""
    rows, columns = tables.grid
    levels = ", ".join(f"{level:.4g}" for level in tables.levels)
    turns = f"Each of the {tables.truths} members is the truth in turn in Tables I and II: medians, and the worst truth. "
    modes = "all modes" if tables.plan_modes is None else f"at most {tables.plan_modes} modes"
    return (
        f"{tables.members} members of `{tables.ensemble}` on {rows} x {columns} points and levels {levels} m; truth `{tables.truth}`; seed "
        f"{tables.seed}. {turns if tables.truths > 1 else ''}Table III and the figures show truth `{tables.shown_truth}`; plans are made "
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


def glides(tables: PaperTables) -> str:
    """Return how the depth-averaged truth compares in Table III, and why."""
    ranked = sorted((row for row in tables.table3 if not row.note), key=lambda row: row.median)
    average = next(row for row in ranked if row.flow == AVERAGED)
    others = [row for row in ranked if row.flow not in (TRUTH, AVERAGED)]
    listed = ", ".join(
        f"{LABELS[row.flow]} {number(row.median, 0)} m ({row.within_250})" for row in others
    )
    better = [LABELS[row.flow] for row in others if row.median < average.median]
    compared = f"Better than it: {', '.join(better)}." if better else "No estimate does better."
    near = f"{average.within_250} of {average.pairs} within 250 m"
    return (
        f"The depth-averaged truth passes the targets at a median of {number(average.median, 0)} m, {near}. {compared} The estimates: "
        f"{listed}. The average carries {100.0 * tables.coherence:.0f} % of this truth's mean squared speed down to "
        f"{tables.target_depth:g} m. A glide at one vertical speed spends the same time at every depth, so the average gives the whole "
        "drift of a current that does not change along the path, however it changes with depth. What it misses is that the glide "
        "meets the upper current in one place and the lower one in another: little where the current is coherent in depth, or wide "
        "against the glide. It also knows the truth, which an estimate has to infer from pings."
    )


def _against_mean(rows: Sequence[SparseRow]) -> str:
    mean, default = (
        {row.pings: row.rel_error for row in rows if row.method == method}
        for method in ("ensemble_mean", "default")
    )
    to_mean, to_default = [], []
    for method in ("paper", "paper_cells", "default"):
        of_method = [row for row in rows if row.method == method]
        if not of_method:
            continue
        worse = [row for row in of_method if not row.rel_error < mean[row.pings]]
        listed = ", ".join(
            f"{row.pings} pings ({number(row.rel_error)} against {number(mean[row.pings])})"
            for row in worse
        )
        to_mean.append(
            f"{LABELS[method]}: "
            + (
                f"worse than the ensemble mean at {listed}"
                if worse
                else "better than the ensemble mean"
            )
        )
        times = [row.rel_error / default[row.pings] for row in of_method]
        to_default += (
            [f"{LABELS[method]} {number(min(times), 1)} to {number(max(times), 1)} times"]
            if method != "default"
            else []
        )
    return f"{'; '.join(to_mean)}. Error over that of {LABELS['default']} at the same count: {', '.join(to_default)}."


def _ordering(rows: Sequence[ErrorRow]) -> str:
    bounds: dict[str, list[str]] = {}
    for row in rows:
        if row.rung:
            bounds.setdefault(row.method, []).append(f"{number(row.bound, 4)} m/s with {row.modes}")
    listed = "; ".join(
        f"{LABELS[method]}: {', '.join(of_method)}" for method, of_method in bounds.items()
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
