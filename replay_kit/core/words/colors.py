"""Colours of figures and pages: a palette by role for each medium, and colour scales for colour-blind readers and print.

The scales are those of cmocean (Thyng et al., 2016, "True colors of oceanography", doi:10.5670/oceanog.2016.66; MIT licence), at equal
steps; ``speed`` is its ``ice`` reversed. The package itself is no dependency: it needs functions that matplotlib 3.13 removed.
"""

#: Colours of lines that colour-blind readers tell apart too (Okabe and Ito, 2008): they differ in lightness.
LINES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_ROLES = ("one", "two", "three", "four", "ink", "soft", "land", "paper")
#: By role: on a light page, on paper that a page is printed on and in exported files; on a dark page; in figures of a paper.
LIGHT, DARK, PRINT = (
    dict(zip(_ROLES, row.split(), strict=True))
    for row in (
        "#00618f #b8500f #5b6b78 #8a2c6a #1b2530 #55636f #c9c4ba #ffffff",
        "#6db9e8 #f29a5c #9fb0bd #dc8cc0 #e6edf3 #a3b1bd #4c4a45 #11181f",
        f"{' '.join(LINES[:4])} #111820 #7f8890 #c9c5bd #ffffff",
    )
)
#: Of areas to keep out of.
NO_GO = "#aa2819"
#: What stands for what, on maps, sections, in print, exports and layouts alike: colour by role or as it is, and symbol by plotly's name.
SYMBOLS = {
    name: (color, symbol)
    for name, color, symbol in map(
        str.split,
        (
            "track ink circle",
            "vehicle ink circle",
            "fix ink circle-open",
            "plan two circle",
            "goal two cross",
            "predicted two diamond",
            "actual ink x",
            f"no_go {NO_GO} square",
        ),
    )
}

#: ``speed`` for magnitudes, ``speed-dark`` the same on a dark page, ``balance`` for signed values, ``amp`` for errors.
_SCALES = {
    "speed": "eafdfd cfedef b1dee2 93cfd8 7bbfd0 68aeca 589dc3 4b8cbd 427bb7 3e69b0 3f57a3 3e478f",
    "speed-dark": "1a1a36 2e2c5a 383975 3e478f 3f57a3 3e69b0 427bb7 4b8cbd 589dc3 68aeca 7bbfd0 93cfd8 b1dee2",
    "balance": "171c42 263176 2448af 0e6abc 3887b9 64a2bb 97b9c5 c7d2d6 f0eceb e2c6be d6a18f cb7d62 bf573a ad2d24 8d0f28 620e22 3c0911",
    "amp": "f1ecec e9d9d5 e2c7be dcb4a7 d7a290 d19079 cc7d63 c66b4e bf583a b8432b ae2e24 a01b25 8e1028 790e28 640e23 4f0c1b 3c0911",
}


def scale(name: str) -> list[tuple[float, str]]:
    """Return a colour scale as pairs of position in [0, 1] and colour."""
    colors = _SCALES[name].split()
    return [(k / (len(colors) - 1), f"#{color}") for k, color in enumerate(colors)]


def palette_css() -> str:
    """Return the palettes as CSS variables, such as ``--one``."""

    def rule(selector: str, palette: dict[str, str]) -> str:
        return f"{selector} {{ {' '.join(f'--{role}: {color};' for role, color in palette.items())} }}\n"

    dark = f"@media (prefers-color-scheme: dark) {{ {rule(':root', DARK)}}}\n"
    return (
        rule(":root", LIGHT)
        + dark
        + rule(":root.printing", LIGHT | {"ink": "#000000", "soft": "#333333"})
    )
