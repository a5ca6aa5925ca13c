"""Notes that say the same are one, with the range of their numbers and the names of their variables."""

from replay_kit.logs.payloads import by_variable, merged_notes, short_note


def test_notes_that_differ_in_numbers_alone_are_one_with_their_ranges():
    notes = [
        "m: declination 9.5 degrees",
        "x: VelocityBeam1 of 3",
        "m: declination -1.2 degrees",
        "m: declination 10.25 degrees",
    ]
    # variables read are never merged
    alone = ["x: VelocityBeam2 of 3", "read as depth: x 1", "read as depth: x 2"]
    assert merged_notes([*notes, *alone]) == {
        "m: declination -1.2 to 10.25 degrees": [notes[0], notes[2], notes[3]],
        notes[1]: [notes[1]],
        **{note: [note] for note in alone},
    }


def test_what_is_said_of_several_variables_is_said_once():
    notes = ["lon: no unit", "mean current: 2", "lat: no unit", "depth: computed", "plain"]
    assert by_variable(notes) == [
        "lon, lat: no unit",
        "mean current: 2",
        "depth: computed",
        "plain",
    ]
    words = "2 variables were read by their names, which replay-kit info lists"
    assert short_note("read as time: t, depth: z") == words
