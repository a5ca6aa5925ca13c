"""Payload bytes of an MCAP channel to plain dicts, one decoder a channel.

A payload of any encoding becomes a dict of numbers, strings, bytes, lists and dicts under the schema's names. Protobuf and ROS 1
times become ``{"sec", "nsec"}``; ROS 2 times keep their own ``{"sec", "nanosec"}``.
ROS 2 schemas in IDL are rewritten as the ``ros2msg`` definitions of the same bytes: what ROS generates is read, but for annotations,
constants and includes, which do not change them.
"""

import json
import re
import struct
from collections.abc import Callable, Iterator
from math import prod
from typing import Any

import orjson
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from replay_kit.logs.decode.budget import MAPPING, MOST_SCHEMA, MOST_VALUES, Budget, check_size
from replay_kit.logs.decode.protobuf import protobuf_decoder
from replay_kit.logs.decode.ros import ros_decoder

Decoder = Callable[[bytes], dict[str, Any]]

#: What a decoder raises on a payload that does not fit its schema: the codecs' own errors, and the built-in ones that the
#: ROS decoders let through when they read past the end or meet a type they do not know.
PAYLOAD_ERRORS: tuple[type[Exception], ...] = (
    *(struct.error, DecodeError, McapError),
    *(ValueError, TypeError, LookupError, AttributeError),
    *(NotImplementedError, OverflowError, RecursionError),
)

_ROS_ENCODINGS = frozenset(
    {
        (MessageEncoding.CDR, SchemaEncoding.ROS2),
        (MessageEncoding.CDR, SchemaEncoding.ROS2IDL),
        (MessageEncoding.ROS1, SchemaEncoding.ROS1),
    }
)
_KNOWN = "json, protobuf, cdr with ros2msg or ros2idl, ros1 with ros1msg"


def channel_decoder(message_encoding: str, schema: Schema | None) -> Decoder | str:
    """Return the decoder of a channel's payloads, or the reason why there is none.

    Args:
        message_encoding: As the channel record states it.
        schema: The channel's schema; None when it has none.
    """
    if message_encoding == MessageEncoding.JSON:
        return decode_json
    if schema is None:
        return f"encoding {message_encoding!r} needs a schema and the channel has none"
    pair = f"encoding {message_encoding!r} with schema {schema.name!r} in {schema.encoding!r}"
    try:
        check_size(len(schema.data), MOST_SCHEMA, "its text")
        if (message_encoding, schema.encoding) == (
            MessageEncoding.Protobuf,
            SchemaEncoding.Protobuf,
        ):
            return protobuf_decoder(schema)
        if (message_encoding, schema.encoding) in _ROS_ENCODINGS:
            text = schema.data.decode("utf-8")
            text = (
                ros2msg_from_idl(schema.name, text)
                if schema.encoding == SchemaEncoding.ROS2IDL
                else text
            )
            return ros_decoder(schema.name, text, message_encoding == MessageEncoding.CDR)
    # nothing that a parser makes of a foreign schema may stop the other channels
    except Exception as error:
        return f"{pair}: the schema cannot be parsed: {_words(error)}"
    return f"{pair} is not known; known: {_KNOWN}"


def explain(error: BaseException) -> str:
    """Return one line that says why a payload could not be decoded."""
    return f"payload does not fit the schema: {_words(error)}"


def _words(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__


# possessive, and with a text that does not end matched too: each byte is looked at once
_BARE_NUMBER = re.compile(
    r'"(?:[^"\\]|\\.)*+"?|(-?)\b(inf|infinity|nan)\b', re.IGNORECASE | re.DOTALL
)


def decode_json(data: bytes) -> dict[str, Any]:
    """Return a JSON object as a dict; bare NaN, Infinity, inf and their negatives are numbers.

    Raises:
        ValueError: The bytes are no JSON, or the value is no object.
    """
    value = loads(data)
    if not isinstance(value, dict):
        raise ValueError(f"expected a JSON object, got {type(value).__name__}")
    return value


def loads(data: bytes) -> Any:
    """Return any JSON value, bare numbers as in ``decode_json``.

    Raises:
        ValueError: The bytes are no JSON, or claim more than the budget of a message.
    """
    # a shorter message cannot hold more: a value takes two bytes, a mapping three
    if len(data) > MOST_VALUES // 2:
        Budget(len(data)).spend(
            sum(data.count(mark) for mark in (b",", b"[", b":")) + MAPPING * data.count(b"{")
        )
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError:
        return json.loads(_BARE_NUMBER.sub(_standard_number, data.decode("utf-8")))


def _standard_number(match: re.Match[str]) -> str:
    if match[2] is None:
        return match[0]
    return "NaN" if match[2].lower() == "nan" else f"{match[1]}Infinity"


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
