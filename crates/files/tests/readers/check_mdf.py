"""asammdf reads a file that we wrote. argv: file, what is in it (JSON)"""
import json
import sys

import numpy as np
from asammdf import MDF

path, wanted = sys.argv[1], json.load(open(sys.argv[2]))
with MDF(path) as mdf:
    for name, want in wanted.items():
        # Invalid samples are kept and marked.
        got = mdf.get(name, ignore_invalidation_bits=True)
        assert got.unit == want["unit"], (name, got.unit)
        assert np.array_equal(got.timestamps, want["timestamps"]), name
        values = np.array([np.nan if v is None else v for v in want["values"]])
        gap = np.isnan(values)
        assert np.array_equal(got.samples[~gap], values[~gap]), name
        # A gap is no number, or it is marked as invalid, and then asammdf leaves it out.
        if not np.all(np.isnan(got.samples[gap])):
            assert len(mdf.get(name).samples) == int((~gap).sum()), name
print(f"asammdf: {len(wanted)} channels equal")
