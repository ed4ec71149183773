"""SciPy on a .mat file: tables along MATLAB's axes."""
import json
import sys

import numpy as np
import scipy.io

data = scipy.io.loadmat(sys.argv[1], squeeze_me=True)
want = {c["name"]: c for c in json.load(open(sys.argv[2]))["package"]["characteristics"]}
for name, c in want.items():
    s = data[name]
    shape = [len(a["points"]) for a in c["axes"]] or [len(c["values"])]
    table = np.asarray(s["table"].item()).reshape(-1, order="F")
    assert np.array_equal(table, c["values"]), name
    if len(c["axes"]) == 2:
        assert s["table"].item().shape == tuple(shape), name
    for axis, key in zip(c["axes"], ["bp_x", "bp_y"]):
        assert np.array_equal(s[key].item(), axis["points"]), name
    assert str(s["unit"].item()) == c["unit"], (name, s["unit"])
assert "dynocal" in str(data["provenance"])
print(f"scipy: {len(want)} structs")
