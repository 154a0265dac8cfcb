"""Try the library with damaged files, bad arguments and kills, generated from seeds.

Every trial must end in a result or in an error of the library. `make trials` runs all trials, and
`test_sample.py` a few of them in the test suite. docs/evidence.md describes the trials.
"""
