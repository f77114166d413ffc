"""Scene files: sections, keys, units, bounds, and the error messages that refuse a wrong one.

`scene.scene` reads a file into a `Scene`. `instrument`, `observing`, `atmosphere`, `noise_and_sky`, `sky`, `analysis`
and `numerics` define its sections. `fields` and `units` convert texts to numbers in internal units. `sites` and
`detector_table` read the tables that a scene refers to; `keys` lists all keys.
"""
