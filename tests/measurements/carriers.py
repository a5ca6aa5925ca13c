"""Messages put into an MCAP as other programs write them."""

from io import BytesIO

import orjson
from mcap.writer import Writer


def json_mcap(entries) -> bytes:
    """Return an MCAP of JSON messages; an entry is (time [s], topic, schema, payload as an object or as bytes)."""
    out = BytesIO()
    writer = Writer(out)
    writer.start()
    channels = {}
    for second, topic, schema, payload in entries:
        if topic not in channels:
            guessed = writer.register_schema(schema, "jsonschema", b'{"type": "object"}')
            channels[topic] = writer.register_channel(topic, "json", guessed)
        data = payload if isinstance(payload, bytes) else orjson.dumps(payload)
        writer.add_message(
            channels[topic],
            log_time=int(second * 10**9),
            data=data,
            publish_time=int(second * 10**9),
        )
    writer.finish()
    return out.getvalue()
