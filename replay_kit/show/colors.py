"""The colours of everything shown: a palette of roles for each medium, and scales that colour-blind people read and print keeps.

The scales are those of cmocean (Thyng et al., 2016, "True colors of oceanography", doi:10.5670/oceanog.2016.66; MIT licence), at 17 equal
steps. The package itself is no dependency: it uses what matplotlib 3.13 no longer has.
"""

#: By role, on a light page and on paper that a page is printed on; also of exported files.
LIGHT = {
    **{"one": "#00618f", "two": "#b8500f", "three": "#5b6b78", "four": "#8a2c6a"},
    **{"ink": "#1b2530", "soft": "#55636f", "land": "#c9c4ba"},
}
#: On a dark page.
DARK = {
    **{"one": "#6db9e8", "two": "#f29a5c", "three": "#9fb0bd", "four": "#dc8cc0"},
    **{"ink": "#e6edf3", "soft": "#a3b1bd", "land": "#4c4a45"},
}
#: In figures of a paper (Okabe and Ito, 2008), which differ in lightness too.
PRINT = {
    **{"one": "#0072B2", "two": "#D55E00", "three": "#009E73", "four": "#CC79A7"},
    **{"ink": "#111820", "soft": "#7f8890", "land": "#c9c5bd"},
}
#: Of marks on coloured fields, which are the same on a light and a dark page; of areas to keep out of.
ON_FIELD, NO_GO = "#0f1923", "#aa2819"

#: ``speed`` for magnitudes, ``balance`` for signed values, ``amp`` for errors, ``thermal`` for time.
_SCALES = {
    "speed": "fefccd f4e9ab e8d788 dbc765 c9ba44 b2af28 97a511 7c9b05 5f910c 428618 267a23 116d29 0b5e2c 114f2b 174026 19311d 172312",
    "balance": "171c42 263176 2448af 0e6abc 3887b9 64a2bb 97b9c5 c7d2d6 f0eceb e2c6be d6a18f cb7d62 bf573a ad2d24 8d0f28 620e22 3c0911",
    "amp": "f1ecec e9d9d5 e2c7be dcb4a7 d7a290 d19079 cc7d63 c66b4e bf583a b8432b ae2e24 a01b25 8e1028 790e28 640e23 4f0c1b 3c0911",
    "thermal": "032333 082d54 18337c 39339d 563b9c 6c4594 824f8e 985789 b05f81 c86675 de7064 f07e50 f99341 fbac3c f9c641 f2e04d e7fa5a",
}


def scale(name: str) -> list[tuple[float, str]]:
    """Return a colour scale: positions in 0..1, each with its colour."""
    colors = _SCALES[name].split()
    return [(k / (len(colors) - 1), f"#{color}") for k, color in enumerate(colors)]


def palette_css() -> str:
    """Return the palettes as variables of a page's style, such as ``--one``."""

    def rule(selector: str, palette: dict[str, str]) -> str:
        return f"{selector} {{ {' '.join(f'--{role}: {color};' for role, color in palette.items())} }}\n"

    dark = f"@media (prefers-color-scheme: dark) {{ {rule(':root', DARK)}}}\n"
    return (
        rule(":root", LIGHT)
        + dark
        + rule(":root.printing", LIGHT | {"ink": "#000000", "soft": "#333333"})
    )
