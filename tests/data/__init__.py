"""Reference data of tests, with the scripts that made them."""
