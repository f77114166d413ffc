"""The time-streams of one observation: atmosphere, other noise, and sky, in blocks of whole scans."""
