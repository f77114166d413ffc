"""Scan patterns, one file each: the record of the scans, and the path of the boresight.

`surveysim.telescope.scan_pattern` lists them.
"""
