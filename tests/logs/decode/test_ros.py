"""ROS messages against the stock decoders, on random definitions and bytes, and what a definition may not say."""

import struct

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros1.decoder import DecoderFactory as Ros1Factory
from mcap_ros2._dynamic import generate_dynamic

from replay_kit.logs.decode.ros import Field, definitions, ros_decoder

SEPARATOR = "=" * 80
NUMBERS = [
    "bool",
    "int8",
    "uint8",
    "int16",
    "uint16",
    "int32",
    "uint32",
    "int64",
    "uint64",
    "float32",
    "float64",
    "byte",
    "char",
]


def random_definition(rng, others):
    """Return a definition of a main type and of three that may be in it, with numbers, texts and other kinds."""
    parts = []
    for place, name in enumerate(("A", "B", "C", "D")):
        kinds = [*NUMBERS, "string", *others, *(f"p/{inner}" for inner in "BCD"[place:])]
        lines = []
        for k in range(int(rng.integers(1, 6))):
            kind = str(rng.choice(kinds))
            lines.append(f"{kind}{rng.choice(['', '', '[]', '[3]'])} f{k}")
        parts.append("\n".join([*([f"MSG: p/{name}"] if place else []), *lines]))
    return f"\n{SEPARATOR}\n".join(parts)


def plain(value):
    """Return a message of the stock decoders as ours gives it."""
    if hasattr(value, "secs"):
        return {"sec": value.secs, "nsec": value.nsecs}
    if hasattr(value, "__slots__"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def outcome(decode, data):
    """Return what a decoder gives, as text in which NaN equals NaN; ``error`` where it refuses."""
    try:
        return repr(decode(data))
    # genpy's own error derives from Exception itself
    except Exception:
        return "error"


def payloads(rng):
    """Return bytes in which lengths are small: mostly zeros."""
    data = rng.choice(np.array([0, 1, 2, 65], np.uint8), 4096, p=[0.9, 0.06, 0.03, 0.01]).tobytes()
    return [data, bytes(4096), *(data[k:] for k in range(1, 8))]


def agreed(ours, stock, some):
    """Return how many payloads both read alike; what the stock decoder reads beyond the end of the message, ours refuses."""
    found = 0
    for payload in some:
        said = outcome(ours, payload)
        if said != "error":
            assert said == outcome(stock, payload)
            found += 1
        elif (expected := outcome(stock, payload)) != "error":
            assert outcome(stock, payload + b"\1" * 2**16) != expected
    return found


def _stock_ros1(text):
    schema = Schema(id=1, name="p/A", encoding="ros1msg", data=text.encode())
    return Ros1Factory().decoder_for("ros1", schema)


def _stock_ros2(text):
    return generate_dynamic("p/msg/A", text)["p/A"]


@pytest.mark.parametrize(
    ("others", "name", "stock_of", "orders", "least"),
    [
        (["time", "duration"], "p/A", _stock_ros1, [b""], 60),
        ([], "p/msg/A", _stock_ros2, [b"\0\1\0\0", b"\0\0\0\0"], 120),
    ],
    ids=["ROS 1", "ROS 2"],
)
def test_messages_are_those_of_the_stock_decoder(others, name, stock_of, orders, least):
    found = 0
    for seed in range(15):
        rng = np.random.default_rng(seed)
        text = random_definition(rng, others)
        stock, ours = stock_of(text), ros_decoder(name, text, cdr=len(orders) > 1)
        some = [order + payload for order in orders for payload in payloads(rng)]
        found += agreed(ours, lambda data, stock=stock: plain(stock(data)), some)
    assert found > least


def test_an_empty_message_of_ros2_takes_a_byte_and_one_of_ros1_none():
    text = f"p/E e\nuint8 a\n{SEPARATOR}\nMSG: p/E\n"
    assert ros_decoder("p/A", text, cdr=True)(b"\0\1\0\0\5\7") == {"e": {}, "a": 7}
    assert ros_decoder("p/A", text, cdr=False)(b"\5\7") == {"e": {}, "a": 5}


@pytest.mark.parametrize(
    ("text", "payload"),
    [
        ("string a", struct.pack("<I", 4) + b"abc"),
        ("uint8[] a", struct.pack("<I", 4) + b"abc"),
        ("uint8[4] a", b"abc"),
        ("float64 a", bytes(7)),
        ("string a", struct.pack("<I", 2) + b"\xff\xff"),
    ],
)
def test_a_message_that_ends_within_a_field_is_refused(text, payload):
    for cdr, data in ((False, payload), (True, b"\0\1\0\0" + payload)):
        with pytest.raises((ValueError, struct.error)):
            ros_decoder("p/A", text, cdr)(data)
    with pytest.raises(ValueError, match="3 bytes, fewer than the 4"):
        ros_decoder("p/A", text, cdr=True)(b"\0\1\0")


def test_what_a_definition_declares():
    text = "# comment\nstring NAME='x # y'\nint32<=5 LIMIT = 4\nHeader head # of a package of its own\nB b\nother/msg/C[] c\n"
    text += f"string<=8[<=3] d\nfloat64[4] e\nfloat64 f 1.5\nstring g 'a = b'\n  \n{SEPARATOR}\nMSG: p/B\nbool x\n"
    assert definitions("p/msg/A", text) == {
        "p/A": (
            Field("head", "std_msgs/Header", None),
            Field("b", "p/B", None),
            Field("c", "other/C", -1),
            Field("d", "string", -1),
            Field("e", "float64", 4),
            Field("f", "float64", None),
            Field("g", "string", None),
        ),
        "p/B": (Field("x", "bool", None),),
    }


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("A", "bool a", "no name of a ROS type"),
        ("p/q/r/A", "bool a", "no name of a ROS type"),
        ("p/A b", "bool a", "no name of a ROS type"),
        ("p/A", "bool a; bool b", "not a field declaration"),
        ("p/A", "bool[3][3] a", "not a field declaration"),
        ("p/A", "bool", "not a field declaration"),
        ("p/A", "B a", "definition not found: p/B"),
        ("p/A", "wstring a", "values of the type wstring are not read"),
        ("p/A", "time a", "values of the type time are not read"),
    ],
)
def test_a_definition_that_cannot_be_understood_is_refused(name, text, words):
    with pytest.raises(ValueError, match=words):
        ros_decoder(name, text, cdr=True)
