"""The scene file: sections, keys, units, bounds and the errors that refuse a wrong one.

`scene.scene` reads a file into a `Scene`; the other modules hold one section each, in internal units. `fields` and
`units` turn texts into numbers, `sites` and `position_table` read the tables that a scene names.
"""
