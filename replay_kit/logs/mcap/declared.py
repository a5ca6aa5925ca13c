"""Channels and schemas of a file being written, each declared once, before its first message."""

from mcap.writer import Writer

from replay_kit.logs.raw import RawChannel


class OutChannels:
    """Gives the numbers of channels in the file being written."""

    def __init__(self, writer: Writer) -> None:
        """Begin with none.

        Args:
            writer: Where new ones are declared.
        """
        self._writer = writer
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[tuple[int, RawChannel], int] = {}

    def number(self, input: int, channel: RawChannel) -> int:
        """Return a channel's number in the file, declared when it is new.

        Args:
            input: Tells the channels of one log from those of another.
            channel: The channel.
        """
        key = (input, channel)
        number = self._channels.get(key)
        if number is None:
            number = self._writer.register_channel(channel.topic, channel.encoding, self._schema(channel), dict(channel.metadata))
            self._channels[key] = number
        return number

    def _schema(self, channel: RawChannel) -> int:
        if channel.schema is None:
            return 0
        if channel.schema not in self._schemas:
            self._schemas[channel.schema] = self._writer.register_schema(*channel.schema)
        return self._schemas[channel.schema]
