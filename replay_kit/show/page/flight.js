"use strict";
// A glider that steers for waypoints through gridded currents: the rule of replay_kit/results/views/steering.py, line by line.
// currents: {depths, east, north, velocity(flow, depth, component, row, column)}; dives: {speed, angle [rad], depth, surfaceTime, maxDuration, radius, steps, leastDive, tries}
function cellOf(axis, value) {
  if (axis.length === 1) return [0, 0];
  let k = axis.findIndex((edge) => edge > value) - 1;
  if (value >= axis[axis.length - 1]) k = axis.length - 2;
  k = Math.min(Math.max(k, 0), axis.length - 2);
  return [k, Math.min(Math.max((value - axis[k]) / (axis[k + 1] - axis[k]), 0), 1)];
}

function currentAt(currents, flow, [east, north], depth) {
  const [[d, fd], [j, fj], [i, fi]] = [cellOf(currents.depths, depth), cellOf(currents.north, north), cellOf(currents.east, east)];
  const mixed = (a, b, f) => a + f * (b - a);
  return [0, 1].map((component) => {
    const row = (level, r) => mixed(currents.velocity(flow, level, component, r, i), currents.velocity(flow, level, component, r, i + 1), fi);
    const level = (l) => mixed(row(l, j), row(l, j + 1), fj);
    return currents.depths.length === 1 ? level(0) : mixed(level(d), level(d + 1), fd);
  });
}

function steer(dives, ahead, expected) {
  const along = dives.speed * Math.cos(dives.angle);
  const duration = (2 * dives.depth) / (dives.speed * Math.sin(dives.angle));
  const far = Math.hypot(...ahead);
  const direction = far > 0 ? [ahead[0] / far, ahead[1] / far] : [0, 1];
  const left = [-direction[1], direction[0]];
  const across = Math.min(Math.max(-(expected[0] * left[0] + expected[1] * left[1]), -along), along);
  const forward = Math.sqrt(along * along - across * across);
  const madeGood = forward + expected[0] * direction[0] + expected[1] * direction[1];
  const share = madeGood > 0 ? far / (madeGood * duration) : 1;
  const through = [0, 1].map((k) => forward * direction[k] + across * left[k]);
  return { through, share: Math.min(Math.max(share, dives.leastDive), 1), duration };
}

function diveOf(currents, flow, dives, begin, through, depth, duration) {
  const step = duration / dives.steps;
  const depthAt = (share) => depth * (1 - Math.abs(2 * share - 1));
  let place = begin;
  for (let k = 0; k < dives.steps; k += 1) {
    const here = currentAt(currents, flow, place, depthAt(k / dives.steps));
    const half = [0, 1].map((c) => place[c] + 0.5 * step * (through[c] + here[c]));
    const there = currentAt(currents, flow, half, depthAt((k + 0.5) / dives.steps));
    place = [0, 1].map((c) => place[c] + step * (through[c] + there[c]));
  }
  return place;
}

function flyToWaypoints(currents, flow, dives, start, waypoints) {
  let [place, time, passed] = [start, 0, false];
  const surfacings = [start];
  const sum = [0, 0];
  for (let k = 0; k <= dives.steps; k += 1) currentAt(currents, 0, start, (dives.depth * k) / dives.steps).forEach((value, c) => { sum[c] += value; });
  let expected = sum.map((value) => value / (dives.steps + 1));
  for (const waypoint of waypoints) {
    let tries = 0;
    passed = false;
    while (!passed && time < dives.maxDuration) {
      const begin = place;
      const steered = steer(dives, [waypoint[0] - place[0], waypoint[1] - place[1]], expected);
      const duration = steered.share * steered.duration;
      place = diveOf(currents, flow, dives, begin, steered.through, steered.share * dives.depth, duration);
      expected = [0, 1].map((c) => (place[c] - begin[c]) / duration - steered.through[c]);
      time += duration;
      tries += steered.share < 1 ? 1 : 0;
      passed = tries === dives.tries || Math.hypot(waypoint[0] - place[0], waypoint[1] - place[1]) <= dives.radius;
      if (!passed) {
        const drift = currentAt(currents, flow, place, 0);
        place = [0, 1].map((c) => place[c] + dives.surfaceTime * drift[c]);
        time += dives.surfaceTime;
      }
      surfacings.push(place);
    }
    if (!passed) break;
  }
  const goal = waypoints[waypoints.length - 1];
  return { duration: time, miss: Math.hypot(goal[0] - place[0], goal[1] - place[1]), arrived: passed, surfacings };
}
