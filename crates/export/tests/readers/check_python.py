"""Runs the exported Python file on a record."""
import importlib.util
import sys

import numpy as np

path, record, name = sys.argv[1:4]
spec = importlib.util.spec_from_file_location("exported", path)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
program = getattr(module, name)()
data = np.loadtxt(record, ndmin=2)
m = len(program.INPUTS)
worst = 0.0
for row in data:
    y = np.array(program.step(row[:m]), dtype=float)
    worst = max(worst, float(np.max(np.abs(y - row[m:]) / (1 + np.abs(row[m:])))))
assert worst < 1e-12, worst
print(f"python: {len(data)} samples, largest relative difference {worst:.1e}")
