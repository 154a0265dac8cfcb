"""Trials: damaged files, bad arguments and kills, made from seeds.

Every trial must end in a result or in an error of the library's own. `python -m trials` (from `tests/`, or
`make trials`) runs all of them; `test_sample.py` runs a few in the test suite. docs/reliability.md says what is
tried and what is promised.
"""
