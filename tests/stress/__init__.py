"""Runs that are killed, that meet, and that go on for long: nothing of theirs or of the user's is lost."""
