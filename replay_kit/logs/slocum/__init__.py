"""Binary files of Slocum gliders: header, list of sensors and cycles; raw or compressed."""
