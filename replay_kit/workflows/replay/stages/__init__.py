"""The stages of a replay: functions of frozen states, which know neither the writer nor the clock."""
