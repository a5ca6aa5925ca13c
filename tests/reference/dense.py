"""The slow obvious estimate: one Gaussian of all unknowns at all times, point by point and with explicit inverses.

A measurement is rows of the weights of all modes at all levels, times the loading at the time of each of its points. Unknowns are
independent, and each has the correlation exp(-|dt| / tau) with itself at another time; those of oscillations and of instruments follow the
current's.
"""

import numpy as np

from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.observation import Profiles
from tests.reference.estimator import log_density
from tests.reference.lattice import matrix

M2 = np.deg2rad(28.9841042) / 3600.0


def hats(depth, levels):
    """Weights of levels at a depth, linear between them."""
    return np.array([np.interp(depth, levels, one) for one in np.eye(len(levels))])


class Near:
    """How much was measured near each node so far: the error that all of it shares is counted once, and forgotten with the current."""

    def __init__(self, twin):
        self.twin, self.time_ns, self.sums = twin, 0, {}

    def rows(self, given, others=()):
        """The rows of a measurement, and of those at its place and time, with the error that they have beside the earlier ones."""
        group = [given, *others]
        found = [self.twin.rows(each, group if others else None) for each in group]
        if not given.linear.at_one_place and len(given.linear.value) > 1:
            return found
        now = int(np.mean([each.time_ns for each in group]))
        if now > self.time_ns:
            kept = np.exp(-(now - self.time_ns) / 1e9 / self.twin.tau.min())
            self.sums = {node: kept * each for node, each in self.sums.items()}
            self.time_ns = now
        node, ratios = zip(*(self.twin.ratio(each.linear) for each in group), strict=True)
        before = self.sums.get(node[0], 0.0)
        after = self.sums[node[0]] = before + sum(ratios)
        return [
            (design, value, noise * (1.0 + before) * (1.0 + after) / (1.0 + ratio))
            for (design, value, noise), ratio in zip(found, ratios, strict=True)
        ]


class Twin:
    """Of a flow before any measurement, and the configuration of time."""

    def __init__(self, flow, time=None, stated_std=None):
        self.flow, self.process, self.stated_std = flow, flow.unknowns.process, stated_std
        self.biases = () if time is None else time.biases
        self.time, self.pairs, tau = time, [], [self.process.tau]
        if time is not None and time.oscillators:
            deepest, length = flow.levels[-1], 100.0
            self.knots = np.linspace(0.0, deepest, max(2, int(np.ceil(2 * deepest / length)) + 1))
            apart = (self.knots[:, None] - self.knots) / length
            cov = np.exp(-0.5 * apart**2) + 1e-9 * np.eye(self.knots.size)
            self.root = 0.1 * np.linalg.cholesky(cov)
            sine = np.sin(np.deg2rad(flow.grid.projection.latitude))
            for name in time.oscillators:
                omega = 2 * 7.292115e-5 * sine if name == "inertial" else M2
                both = [None] if name == "inertial" else [0, 1]
                self.pairs += [(omega, component) for component in both]
            tau.append(np.full(2 * len(self.pairs) * self.knots.size, 259200.0))
        self.tau = np.concatenate([*tau, np.full(len(self.biases), np.inf)])

    def at(self, values, time_ns):
        """What is given at the forecast's times, at another."""
        times = self.process.times_ns
        seconds = (times - times[0]) / 1e9
        flat = values.reshape(len(values), -1).T
        found = [np.interp((time_ns - int(times[0])) / 1e9, seconds, each) for each in flat]
        return np.array(found).reshape(values.shape[1:])

    def mean(self, time_ns):
        """All weights of unknowns that are zero."""
        return self.at(self.process.mean, time_ns).ravel()

    def loading(self, time_ns):
        """All weights of one unit of each unknown, one a row."""
        process = self.process
        fixed = self.at(process.spread, time_ns) * process.fixed
        patterns = np.concatenate([self.at(process.moving, time_ns), fixed])
        return np.array([(process.functions.T @ one).ravel() for one in patterns])

    def oscillating(self, depth, time_ns):
        """The current of one unit of each unknown of the oscillations, east and north."""
        out = []
        seconds = (time_ns - int(self.process.times_ns[0])) / 1e9
        at_knots = hats(depth, self.knots) @ self.root if self.pairs else []
        for omega, component in self.pairs:
            for unit in (1.0, 1j):
                for value in at_knots:
                    z = unit * value * np.exp(-1j * omega * seconds)
                    both = [z.real, z.imag] if component is None else [0.0, 0.0]
                    if component is not None:
                        both[component] = z.real
                    out.append(both)
        return np.array(out).reshape(-1, 2).T

    def erring(self, relative, distance):
        """The effect of one prior standard deviation of each error of an instrument."""
        east, north = relative
        speed = max(np.hypot(east, north), 1e-300)
        effects = {
            "heading": np.deg2rad(5.0) * np.array([north, -east]),
            "scale": 0.05 * np.array([east, north]),
            "shear": -2e-4 * distance / speed * np.array([east, north]),
        }
        return np.array([effects[name] for name in self.biases]).T

    def point(self, place, depth, time_ns):
        """The known part of the current at a point, the effect of one unit of each unknown of it, and the error beside them."""
        flow, levels = self.flow, self.flow.levels
        row = matrix(flow.horizontal, [place])
        share = hats(depth, levels)
        if flow.depth_functions.kind == "gaussian":
            off = (max(depth, levels[0]) - levels) / flow.depth_functions.length
            share = np.exp(-0.5 * off**2)
        on_weights = np.array([np.kron(share, each) for each in row @ flow.modes])
        known = row @ flow.unknowns.offset @ share + on_weights @ self.mean(time_ns)
        if flow.potential is not None:
            turned = row @ flow.potential @ share
            known = known + np.array([-turned[1], turned[0]])
        node = np.argmin(np.hypot(*(flow.nodes - place).T))
        error = np.interp(depth, levels, flow.unknowns.error[:, node])
        effect = on_weights @ self.loading(time_ns).T
        return known, np.hstack([effect, self.oscillating(depth, time_ns)]), error

    def rows(self, given, group=None):
        """Design, values about what is known, and the covariance of their errors; differences where the values are relative."""
        given, projection = given.linear, self.flow.grid.projection
        around = (given if group is None else Profiles.of(group)), given.depth.size
        lon, lat = (np.resize(getattr(around[0], x), around[1]) for x in ("longitude", "latitude"))
        times = given.point_time_ns
        times = np.full(around[1], around[0].time_ns) if times is None else times
        weights = np.eye(around[1]) if given.weights is None else given.weights
        points = [
            self.point(np.array(to_local(projection, *place)), depth, time_ns)
            for *place, depth, time_ns in zip(lon, lat, given.depth, times.tolist(), strict=True)
        ]
        known, design, error = (np.array(each) for each in zip(*points, strict=True))
        used = np.flatnonzero(
            (given.flags <= 3)
            & np.isfinite(given.value).all(axis=1)
            & (given.value_depth <= self.flow.levels[-1])
        )
        here = projection, given.longitude[-1], given.latitude[-1]
        # both components are turned to the local axes, one alone stays as it is
        value, along = given.value, np.eye(2)
        if len(given.components) == 2:
            value = np.column_stack(rotate_to_local(*here, *(value @ given.components).T))
        else:
            along = np.column_stack(rotate_to_local(*here, *given.components.T))
        if self.biases:
            effect = np.zeros((len(points), 2, len(self.biases)))
            known_motion = given.platform_velocity or np.isinf(given.common_std)
            if given.at_one_place and len(given.components) == 2 and known_motion:
                members = [given] if group is None else [each.linear for each in group]
                moved = [
                    rotate_to_local(
                        projection,
                        each.longitude[0],
                        each.latitude[0],
                        *(each.value[used] - (each.platform_velocity or (0, 0))).mean(axis=0),
                    )
                    for each in members
                ]
                relative = np.mean(moved, axis=0)
                distance = np.abs(given.depth - given.depth[0])
                effect = np.array([self.erring(relative, each) for each in distance])
            design = np.concatenate([design, effect], axis=2)
        noise, relative = self.noise(given), not np.isfinite(given.common_std)
        if self.stated_std is None or not given.at_one_place:
            noise = noise + np.diag((weights @ error) ** 2)
        design = np.einsum("np,pck,ac->ank", weights, design, along)[:, used]
        off = value - weights @ known @ along.T
        design, value = design.reshape(-1, design.shape[2]), off[used].T.ravel()
        noise = np.kron(np.eye(len(along)), noise[np.ix_(used, used)])
        if not relative:
            return design, value, noise
        contrast = np.kron(np.eye(len(along)), np.diff(np.eye(used.size), axis=0))
        return contrast @ design, contrast @ value, contrast @ noise @ contrast.T

    def noise(self, given):
        """The covariance of the errors of values, without that of what the basis cannot represent."""
        own, depth = given.error_std, given.value_depth
        if self.stated_std is not None and given.at_one_place:
            return self.stated_std**2 * np.eye(own.size)
        alike = np.eye(own.size)
        if given.correlation is not None:
            alike = given.correlation
        elif given.correlation_depth:
            alike = np.exp(-np.abs(depth[:, None] - depth) / given.correlation_depth)
        common = given.common_std if np.isfinite(given.common_std) else 0.0
        return np.outer(own, own) * alike + common**2

    def ratio(self, given):
        """The node near a measurement, and how large its error is beside that of what is measured of each level, on average."""
        flow, projection = self.flow, self.flow.grid.projection
        if not given.at_one_place:
            # of a mean along a path: near its middle
            places = np.column_stack(to_local(projection, given.longitude, given.latitude))
            near = [np.argmin(np.hypot(*(flow.nodes - place).T)) for place in places]
            errors = [
                np.interp(depth, flow.levels, flow.unknowns.error[:, node])
                for depth, node in zip(given.depth, near, strict=True)
            ]
            middle = given.weights[0] @ places / given.weights[0].sum()
            node = int(np.argmin(np.hypot(*(flow.nodes - middle).T)))
            return node, float((given.weights[0] @ errors) ** 2 / self.noise(given)[0, 0])
        place = to_local(projection, given.longitude[0], given.latitude[0])
        node = int(np.argmin(np.hypot(*(flow.nodes - np.array(place)).T)))
        used = (given.flags <= 3) & np.isfinite(given.value).all(axis=1)
        used &= given.value_depth <= flow.levels[-1]
        weights = np.eye(given.depth.size) if given.weights is None else given.weights
        shares = (weights @ np.array([hats(depth, flow.levels) for depth in given.depth]))[used]
        known = np.linalg.inv(self.noise(given)[np.ix_(used, used)])
        each = np.diag(shares.T @ known @ shares) * flow.unknowns.error[:, node] ** 2
        return node, 0.0 if self.stated_std is not None else float(each[each > 0.0].mean())

    def joint(self, seen, at_ns):
        """Mean and covariance of all unknowns at a time, of rows that each count at a time of theirs."""
        if not seen:
            return np.zeros(self.tau.size), np.eye(self.tau.size)
        rows, times = zip(*seen, strict=True)

        def kept(one, other):
            return np.exp(-abs(one - other) / 1e9 / self.tau)

        blocks = [[h * kept(t, s) @ g.T for (g, _, _), s in seen] for (h, _, _), t in seen]
        noise = np.zeros_like(whole := np.block(blocks))
        ends = np.cumsum([0, *(len(y) for _, y, _ in rows)])
        for k, (_, _, r) in enumerate(rows):
            noise[ends[k] : ends[k + 1], ends[k] : ends[k + 1]] = r
        cross = np.hstack(
            [(g * kept(at_ns, s)).T for (g, _, _), s in zip(rows, times, strict=True)]
        )
        gain = cross @ np.linalg.inv(whole + noise)
        return gain @ np.concatenate([y for _, y, _ in rows]), np.eye(len(cross)) - gain @ cross.T

    def predicted(self, seen, rows, at_ns):
        """Normalised square, log-density and degrees of freedom for signal of values after others."""
        x, p = self.joint(seen, at_ns)
        design, value, noise = rows
        cov = design @ p @ design.T + noise
        off = value - design @ x
        signal = np.trace((cov - noise) @ np.linalg.inv(cov))
        return off @ np.linalg.inv(cov) @ off, log_density(off, 0.0, cov), signal

    def velocity(self, x, p, place, depth, time_ns):
        """Mean of the current at a point, and the variance of each component with the error beside the unknowns."""
        known, effect, error = self.point(place, depth, time_ns)
        effect = effect[:, : self.process.size]
        own = slice(0, self.process.size)
        return known + effect @ x[own], np.diag(effect @ p[own, own] @ effect.T) + error**2
