"""Trials: damaged files, bad arguments and kills, made from seeds.

Every trial must end in a result or in an error of the library's own. `make trials` runs all of them,
`test_sample.py` a few in the test suite. docs/evidence.md says what is tried and what is promised.
"""
