"""FMPy: validates, simulates with the binary inside, compiles the sources with warnings as errors, simulates again."""
import json
import shutil
import subprocess
import sys
import tempfile
import zipfile

import numpy as np
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

path, record, wanted = sys.argv[1:4]
program = json.load(open(wanted))["package"]["program"]
problems = validate_fmu(path)
assert not problems, problems
data = np.loadtxt(record, ndmin=2)
dt = program["sample_time_s"]
names = [i["name"] for i in program["inputs"]]
m = len(names)
u = np.zeros(len(data), dtype=[("time", float)] + [(n, float) for n in names])
u["time"] = np.arange(len(data)) * dt
for k, n in enumerate(names):
    u[n] = data[:, k]


def check(fmu, what):
    out = [o["name"] for o in program["outputs"]]
    # Inputs change at communication points only: they are read as steps, at the point itself.
    r = simulate_fmu(fmu, input=u, stop_time=(len(data) - 1) * dt, step_size=dt, output_interval=dt, output=out)
    got = np.stack([r[n] for n in out], 1)[1:]
    want = data[: len(got), m:]
    error = np.max(np.abs(got - want) / (1 + np.abs(want)))
    assert len(got) >= len(data) - 2 and error < 1e-9, (what, len(got), error)
    return error


binary = check(path, "binary")
with tempfile.TemporaryDirectory() as folder:
    bare = f"{folder}/bare.fmu"
    with zipfile.ZipFile(path) as a, zipfile.ZipFile(bare, "w") as b:
        assert any(n.startswith("binaries/") for n in a.namelist()), "no binary"
        for n in a.namelist():
            if not n.startswith("binaries/"):
                b.writestr(n, a.read(n))
    done = subprocess.run(
        [sys.executable, "-m", "fmpy", "compile", "--warning-as-error", bare], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    compiled = check(bare, "compiled")
print(f"FMPy: valid, binary {binary:.1e}, compiled {compiled:.1e} over {len(data)} samples")
