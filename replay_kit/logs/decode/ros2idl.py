"""ROS 2 schemas in IDL, rewritten as the ``ros2msg`` definitions that the decoder package understands.

Both describe the same bytes; only the text differs. The parser reads what ROS generates: modules, structs, enums, typedefs,
sequences, bounded strings and arrays. It skips annotations, constants and includes, which do not change the bytes.
"""

import re
from collections.abc import Iterator
from math import prod

# What looks ahead for an end takes the rest of the text where there is none: each byte is looked at once.
_TOKEN = re.compile(
    r'//[^\n]*|/\*.*?(?:\*/|\Z)|^[^\S\n]*#[^\n]*|^=++$|^IDL:[^\n]*|("(?:[^"\\]|\\.)*+"?|[\w:.+-]+|\S)',
    re.DOTALL | re.MULTILINE,
)
_PRIMITIVES = {
    "float": "float32",
    "double": "float64",
    "boolean": "bool",
    "octet": "byte",
    "short": "int16",
    "unsigned short": "uint16",
    "long": "int32",
    "unsigned long": "uint32",
    "long long": "int64",
    "unsigned long long": "uint64",
}
_PLAIN = {
    "string",
    "wstring",
    "char",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
}


def ros2msg_from_idl(name: str, text: str) -> str:
    """Return the ``ros2msg`` definition of a type, with those of all other types of the text after it.

    Args:
        name: The type, as ``package/msg/Name``.
        text: One or more IDL files, one after the other.

    Raises:
        ValueError: The text is no IDL, holds constructs that ROS does not generate, is nested too deeply, or lacks the type.
    """
    try:
        structs = _Parser(text).definitions()
    except RecursionError as error:
        raise ValueError("the IDL is nested too deeply") from error
    if name not in structs:
        raise ValueError(
            f"the IDL does not define {name}; it defines {', '.join(structs) or 'nothing'}"
        )
    parts = [structs.pop(name)]
    for other, fields in structs.items():
        package, *_, last = other.split("/")
        parts.append(f"{'=' * 80}\nMSG: {package}/{last}\n{fields}")
    return "\n".join(parts)


class _Parser:
    def __init__(self, text: str) -> None:
        self._tokens = [match[1] for match in _TOKEN.finditer(text) if match[1]]
        self._at = 0
        # Name to (ros2msg type, lengths of its dimensions); enums are the unsigned numbers they are sent as.
        self._aliases: dict[str, tuple[str, str]] = {}
        self._structs: dict[str, str] = {}

    def definitions(self) -> dict[str, str]:
        """Return the fields of each struct, one a line, by the struct's name with slashes."""
        while self._at < len(self._tokens):
            self._definition(())
        return self._structs

    def _definition(self, scope: tuple[str, ...]) -> None:
        word = self._next()
        if word == "@":
            self._annotation()
        elif word == "module":
            inner = (*scope, self._next())
            for _ in self._braces():
                self._definition(inner)
        elif word == "struct":
            name = "/".join((*scope, self._next()))
            self._structs[name] = "\n".join(
                line for _ in self._braces() if (line := self._member())
            )
        elif word == "enum":
            self._aliases[self._next()] = ("uint32", "")
            for _ in self._braces():
                self._next()
        elif word == "typedef":
            kind, suffix = self._type()
            alias = self._next()
            self._aliases[alias] = (kind, self._dimensions() or suffix)
            self._expect(";")
        elif word == "const":
            while self._next() != ";":
                pass
        else:
            raise ValueError(f"{word!r} is not understood in IDL")

    def _braces(self) -> Iterator[None]:
        """Yield once for each item between braces, which the caller reads."""
        self._expect("{")
        while self._peek() != "}":
            yield
        self._next()
        self._expect(";")

    def _member(self) -> str:
        """Return one field as ``type name``; nothing for an annotation."""
        if self._peek() == "@":
            self._next()
            self._annotation()
            return ""
        kind, suffix = self._type()
        name = self._next()
        dimensions = self._dimensions()
        if dimensions and suffix:
            raise ValueError(f"field {name!r}: an array of arrays is not understood")
        self._expect(";")
        return f"{kind}{dimensions or suffix} {name}"

    def _type(self) -> tuple[str, str]:
        """Return (element type, array suffix)."""
        word = self._next()
        if word == "sequence":
            self._expect("<")
            kind, suffix = self._type()
            bound = f"<={self._next()}" if self._skip(",") else ""
            self._expect(">")
            if suffix:
                raise ValueError("a sequence of arrays is not understood")
            return kind, f"[{bound}]"
        while word in ("unsigned", "long", "unsigned long") and self._peek() in ("short", "long"):
            word = f"{word} {self._next()}"
        if word in ("string", "wstring") and self._skip("<"):
            self._next()
            self._expect(">")
        if word in _PRIMITIVES or word in _PLAIN:
            return _PRIMITIVES.get(word, word), ""
        parts = [part for part in word.split("::") if part]
        if parts[-1] in self._aliases:
            return self._aliases[parts[-1]]
        return (f"{parts[0]}/{parts[-1]}" if len(parts) > 1 else parts[0]), ""

    def _dimensions(self) -> str:
        """Return the suffix of an array, its dimensions multiplied: the bytes are in one row."""
        lengths = []
        while self._skip("["):
            lengths.append(int(self._next()))
            self._expect("]")
        return f"[{prod(lengths)}]" if lengths else ""

    def _annotation(self) -> None:
        self._next()
        if self._skip("("):
            depth = 1
            while depth:
                depth += {"(": 1, ")": -1}.get(self._next(), 0)

    def _peek(self) -> str:
        if self._at >= len(self._tokens):
            raise ValueError("the IDL ends too early")
        return self._tokens[self._at]

    def _next(self) -> str:
        word = self._peek()
        self._at += 1
        return word

    def _skip(self, word: str) -> bool:
        found = self._at < len(self._tokens) and self._tokens[self._at] == word
        self._at += found
        return found

    def _expect(self, word: str) -> None:
        found = self._next()
        if found != word:
            raise ValueError(f"expected {word!r} in IDL, got {found!r}")
