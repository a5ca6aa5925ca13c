"""Stamps of one log, judged with the whole list at hand: what `replay_kit.logs.merge` does message by message."""

DAY = 86_400_000_000_000


def corrected(stamps: list[int]) -> list[int | None]:
    """Return the time of each message, None where its stamp is set aside."""
    times: list[int | None] = []
    offset = 0
    for k, stamp in enumerate(stamps):
        following = stamps[k + 1 : k + 33]
        believed = [time for time in times if time is not None]
        if not believed:
            wrong = [
                other for other in following if other < stamp - DAY or other > stamp + 366 * DAY
            ]
            times.append(None if len(wrong) > len(following) - len(wrong) else stamp)
            continue
        last, time = believed[-1], stamp + offset
        if last - DAY <= time <= last + DAY:
            times.append(time)
            continue
        nearer = [
            other for other in following if abs(other + offset - time) < abs(other + offset - last)
        ]
        alone = not following and last < time <= last + 366 * DAY
        if not alone and len(nearer) <= len(following) - len(nearer):
            times.append(None)
        elif last - DAY <= stamp <= last + DAY:
            offset = 0
            times.append(stamp)
        elif time > last:
            times.append(time)
        else:
            offset = last - stamp
            times.append(last)
    return times
