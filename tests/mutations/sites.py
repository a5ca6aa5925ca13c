"""The places of a module where one point can be changed, found on its syntax tree and written into its text."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

COMPARISONS = {
    ast.Lt: ("<", ("<=", ">=")),
    ast.LtE: ("<=", ("<", ">")),
    ast.Gt: (">", (">=", "<=")),
    ast.GtE: (">=", (">", "<")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: ("is not", ("is",)),
    ast.In: ("in", ("not in",)),
    ast.NotIn: ("not in", ("in",)),
}
ARITHMETIC = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


@dataclass(frozen=True, order=True)
class Site:
    """One change: the characters from ``start`` to ``end`` become ``after``.

    ``statement`` holds the first and the last line of the smallest statement around it, without the body of a compound one,
    ``within`` those of the smallest function, or None for what runs when the module is imported, and ``readers`` those of the
    statements that read the private names which it assigns there.
    """

    start: int
    end: int
    kind: str
    line: int
    before: str
    after: str
    statement: tuple[int, int]
    within: tuple[int, int] | None
    readers: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class Place:
    """Where the walk is: the lines of the statement around it, of the function, and of what reads the names that are assigned."""

    statement: tuple[int, int]
    within: tuple[int, int] | None
    readers: tuple[tuple[int, int], ...] = ()


def apply(source: str, site: Site) -> str:
    """Return ``source`` with the site's change."""
    return source[: site.start] + site.after + source[site.end :]


def sites(source: str) -> list[Site]:
    """Return every change of a module, in the order of its text."""
    tree, text = ast.parse(source), Text(source)
    found = set[Site]()
    for node in tree.body:
        found |= set(_walk(node, Place((1, 1), None, _readers(tree, node)), text))
    return sorted(found)


class Text:
    """A module's text, by the places of its syntax tree, which count bytes of UTF-8 in a line."""

    def __init__(self, source: str):
        self.source = source
        self.lines = source.splitlines(keepends=True)
        self.starts = [0]
        for line in self.lines:
            self.starts.append(self.starts[-1] + len(line))

    def offset(self, line: int, column: int) -> int:
        """Return the character at a line, from 1, and a column in bytes."""
        return self.starts[line - 1] + len(self.lines[line - 1].encode()[:column].decode())

    def start(self, node: ast.AST) -> int:
        """Return the first character of a node."""
        return self.offset(node.lineno, node.col_offset)

    def end(self, node: ast.AST) -> int:
        """Return the character after the last of a node."""
        return self.offset(node.end_lineno, node.end_col_offset)

    def of(self, node: ast.AST) -> str:
        """Return a node's text."""
        return self.source[self.start(node) : self.end(node)]


def _lines(statement: ast.stmt) -> tuple[int, int]:
    """Return the first and the last line of a statement, without its body."""
    body = getattr(statement, "body", None)
    return statement.lineno, max(
        statement.lineno, body[0].lineno - 1
    ) if body else statement.end_lineno


def _readers(tree: ast.Module, node: ast.stmt) -> tuple[tuple[int, int], ...]:
    """Return the lines of the statements that read private names which a statement of the module assigns."""
    targets = (
        node.targets
        if isinstance(node, ast.Assign)
        else [node.target]
        if isinstance(node, ast.AnnAssign)
        else []
    )
    names = {
        each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)
    }
    if not names or not all(name.startswith("_") for name in names):
        return ()
    readers = set()
    for statement in (each for each in ast.walk(tree) if isinstance(each, ast.stmt)):
        first, last = _lines(statement)
        inside = (
            each
            for each in ast.walk(statement)
            if isinstance(each, ast.Name) and first <= each.lineno <= last
        )
        if any(each.id in names and isinstance(each.ctx, ast.Load) for each in inside):
            readers.add((first, last))
    return tuple(sorted(readers))


def _walk(node: ast.AST, place: Place, text: Text) -> Iterator[Site]:
    if isinstance(node, ast.stmt):
        place = Place(_lines(node), place.within, place.readers)
    yield from _changes(node, place, text)
    if isinstance(node, FUNCTIONS) and not isinstance(node, ast.Lambda):
        if node.name == "__repr__":
            return
        inside = Place(place.statement, (node.lineno, node.end_lineno))
        for default in (*node.args.defaults, *filter(None, node.args.kw_defaults)):
            yield from _walk(default, inside, text)
        for child in node.body:
            yield from _walk(child, inside, text)
        return
    for child in _judged_children(node):
        yield from _walk(child, place, text)


def _judged_children(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node's children but those that no test need notice: wording, types, decorators and a programmer's own checks."""
    if isinstance(node, (ast.JoinedStr, ast.Raise, ast.Assert)):
        return
    hidden = {"annotation", "returns", "decorator_list", "bases"}
    for name, value in ast.iter_fields(node):
        if name in hidden or (isinstance(node, ast.keyword) and node.arg == "strict"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child


def _changes(node: ast.AST, place: Place, text: Text) -> Iterator[Site]:
    for kind, start, end, after in _edits(node, place, text):
        line = text.source.count("\n", 0, start) + 1
        yield Site(
            start,
            end,
            kind,
            line,
            text.source[start:end],
            after,
            place.statement,
            place.within,
            place.readers,
        )


def _edits(node: ast.AST, place: Place, text: Text) -> Iterator[tuple[str, int, int, str]]:
    """Yield (kind, start, end, after) of the changes at one node."""
    match node:
        case ast.Compare():
            yield from _compared(node, text)
        case ast.BoolOp():
            word, other = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield from _between("boolean", left, right, word, other, text)
        case ast.BinOp() if (
            type(node.op) in ARITHMETIC and not _is_wording(node) and not _may_be_type(node, place)
        ):
            yield from _between(
                "arithmetic", node.left, node.right, *ARITHMETIC[type(node.op)], text
            )
            if isinstance(node.op, ast.Mult | ast.Div):
                yield (
                    "sign",
                    text.start(node.left),
                    text.end(node.left),
                    f"(-({text.of(node.left)}))",
                )
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            yield (
                "sign",
                text.start(node),
                text.start(node) + (1 if isinstance(node.op, ast.USub) else len("not")),
                "",
            )
        case ast.Constant(value=bool() | int() | float()):
            yield "constant", text.start(node), text.end(node), _other_constant(node.value)
        case ast.If() | ast.IfExp():
            yield (
                "branches",
                text.start(node.test),
                text.end(node.test),
                f"(not ({text.of(node.test)}))",
            )
        case ast.Slice():
            yield from _sliced(node, text)
        case ast.AugAssign() if type(node.op) in ARITHMETIC:
            yield from _between(
                "assignment",
                node.target,
                node.value,
                *(f"{op}=" for op in ARITHMETIC[type(node.op)]),
                text,
            )
            yield "deletion", text.start(node), text.end(node), "pass"
        case ast.Expr(value=ast.Call()) | ast.Raise() | ast.Break() | ast.Continue() | ast.Delete():
            yield "deletion", text.start(node), text.end(node), "pass"
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield "deletion", text.start(node), text.end(node), "pass"


def _between(
    kind: str, left: ast.AST, right: ast.AST, word: str, other: str, text: Text
) -> Iterator[tuple[str, int, int, str]]:
    """Yield the change of the operator ``word`` between two nodes, where comments and brackets may stand too."""
    start = text.end(left)
    gap = re.sub(
        r"#[^\n]*", lambda comment: " " * len(comment[0]), text.source[start : text.start(right)]
    )
    at = re.search(rf"\b{word}\b" if word.isalpha() else re.escape(word), gap)
    if at:
        yield kind, start + at.start(), start + at.end(), other


def _compared(node: ast.Compare, text: Text) -> Iterator[tuple[str, int, int, str]]:
    for left, op, right in zip(
        [node.left, *node.comparators], node.ops, node.comparators, strict=False
    ):
        word, others = COMPARISONS[type(op)]
        for other in others:
            yield from _between("comparison", left, right, word, other, text)


def _sliced(node: ast.Slice, text: Text) -> Iterator[tuple[str, int, int, str]]:
    """Yield ends of a slice off by one; an end that is a number is changed as a constant."""
    for end in (node.lower, node.upper):
        if end is not None and not isinstance(end, ast.Constant):
            yield "slice", text.start(end), text.end(end), f"({text.of(end)}) + 1"
    if node.lower is not None and node.upper is None and node.step is None:
        yield "slice", text.end(node), text.end(node), "-1"
    if node.lower is None and node.upper is not None:
        yield "slice", text.start(node), text.start(node), "1"


def _other_constant(value: float) -> str:
    match value:
        case bool():
            return str(not value)
        case int():
            return str(value + 1)
        case 0.0:
            return "1.0"
        case _:
            return repr(2.0 * value)


def _is_wording(node: ast.BinOp) -> bool:
    """Return whether an operand is written as text: what is added to it or formatted by it is wording."""
    return any(
        isinstance(side, ast.JoinedStr)
        or (isinstance(side, ast.Constant) and isinstance(side.value, str | bytes))
        for side in (node.left, node.right)
    )


def _may_be_type(node: ast.BinOp, place: Place) -> bool:
    return isinstance(node.op, ast.BitOr) and place.within is None
