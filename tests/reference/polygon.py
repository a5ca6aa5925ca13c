"""Inside or outside of a polygon, point by point: how often a ray to the east crosses it."""


def inside(corners, point):
    """Return whether a point (x, y) lies within the corners, the first not repeated."""
    x, y = point
    crossings = 0
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (y0 <= y) != (y1 <= y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            crossings += 1
    return crossings % 2 == 1
