"""The version of every stage's results, part of every key: what is older is made again.

A stage whose results change (an algorithm, a default that no key holds, the layout of an artifact)
gets the next number in the same commit, and what it feeds is made again with it.
`tests/pipeline/test_versions.py` fails when the results of a small study change and no number does.
"""

VERSIONS = {
    "demonstration": 2,
    "ingest": 3,
    "tube ends": 1,
    "prepare": 3,
    "domain": 2,
    "embedding": 2,
    "maps": 1,
    "paper chain": 1,
    "correspondence": 1,
    "adopted": 3,
    "added": 2,
    "model": 2,
    "fields": 1,
    "left-out points": 1,
    "dynamics": 1,
    "covariates": 1,
    "fold": 2,
    "evaluation": 2,
    "animations": 1,
    "report": 2,
    "run": 1,
    "failures": 1,
}
