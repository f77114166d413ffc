"""The command line: commands, options, progress, interrupts and failures."""
