"""The engine's FMU: valid, equal to the program over the record, faster than real time, its state comes back."""
import sys
import time

import numpy as np
from fmpy.validation import validate_fmu
from unit import Unit

path, record = sys.argv[1:3]
problems = validate_fmu(path)
assert not problems, problems
data = np.loadtxt(record)
unit = Unit(path)
inputs, outputs = unit.references("input"), unit.references("output")
m, dt = len(inputs), 0.03
got, saved = [], None
start = time.perf_counter()
for k, row in enumerate(data):
    if k == len(data) // 2:
        saved = (k, unit.save())
    unit.set(inputs, row[:m])
    unit.step(dt)
    got.append(unit.get(outputs))
elapsed = time.perf_counter() - start
got = np.array(got)
error = np.max(np.abs(got - data[:, m:]) / (1 + np.abs(data[:, m:])))
assert error < 1e-9, error
k, state = saved
unit.restore(state)
again = []
for row in data[k : k + 100]:
    unit.set(inputs, row[:m])
    unit.step(dt)
    again.append(unit.get(outputs))
assert np.array_equal(np.array(again), got[k : k + 100]), "the restored state does not continue to the last bit"
parameters = len(unit.names("parameter"))
unit.close()
print(f"engine FMI {unit.about.fmiVersion}: {len(data) * dt:.0f} s in {elapsed:.2f} s = {len(data) * dt / elapsed:.0f} times real time, "
      f"difference {error:.1e}, {m} inputs, {len(outputs)} outputs, {parameters} parameters")
