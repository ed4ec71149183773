"""onnx's full check and onnxruntime on one step and on the free run."""
import json
import os
import sys

import numpy as np
import onnx
import onnxruntime as ort

folder, record, wanted = sys.argv[1:4]
package = json.load(open(wanted))["package"]
program = package["program"]
data = np.loadtxt(record, ndmin=2)
m = len(program["inputs"])
paths = {k: os.path.join(folder, f"{package['name']}_{k}.onnx") for k in ("step", "free_run")}
for path in paths.values():
    onnx.checker.check_model(onnx.load(path), full_check=True)
free = ort.InferenceSession(paths["free_run"], providers=["CPUExecutionProvider"])
feed = {"u": data[:, :m].astype("f4")[:, None, :]}
for i in free.get_inputs():
    if i.name != "u":
        feed[i.name] = np.zeros([d for d in i.shape], "f4")
y = free.run(["y"], feed)[0][:, 0, :]
error = np.max(np.abs(y - data[:, m:]))
assert error < 1e-4, error
step = ort.InferenceSession(paths["step"], providers=["CPUExecutionProvider"])
meta = step.get_modelmeta().custom_metadata_map
assert meta["sample_time_s"] == str(program["sample_time_s"]) and "provenance" in meta
names = meta["regressors"].split(",")
channel = {i["name"]: data[:, k] for k, i in enumerate(program["inputs"])}
channel.update({o["name"]: data[:, m + k] for k, o in enumerate(program["outputs"])})
channel["y"] = channel["out"]
columns = []
for name in names:
    base, _, lag = name.partition("(t-")
    lag = int(lag.rstrip(")")) if lag else 0
    columns.append(np.concatenate([np.zeros(lag), channel[base][: len(data) - lag]]))
y1 = step.run(None, {"phi": np.stack(columns, 1).astype("f4")})[0]
error1 = np.max(np.abs(y1 - data[:, m:]))
assert error1 < 1e-5, error1
print(f"onnxruntime: step {error1:.1e}, free run of {len(data)} samples {error:.1e}")
