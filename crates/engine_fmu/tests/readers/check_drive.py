"""The FMU of a dynamic map drives the FMU of the engine; compared with the record of `calibrate`'s comparison of the maps.

usage: check_drive.py MAP.fmu ENGINE.fmu RECORD.csv LEAD_SAMPLES

The record begins after LEAD_SAMPLES samples at its first row. Demands are its columns `NAME_demand`; what is given and what the
engine answered stand under their own names."""
import csv
import sys

from unit import Unit

map_path, engine_path, record, lead = sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4])
with open(record, newline="", encoding="utf-8") as f:
    rows = list(csv.reader(f))
names = [cell.split(" [")[0] for cell in rows[0]]
columns = {name: [float(row[k]) for row in rows[1:]] for k, name in enumerate(names)}
dt = columns["time"][1] - columns["time"][0]
controller, engine = Unit(map_path), Unit(engine_path)
demanded, commanded = controller.names("input"), controller.names("output")
moved, answered = engine.names("input"), [n for n in engine.names("output") if n in columns]
assert answered and set(commanded) <= set(moved), (commanded, moved, names)
worst = 0.0


def difference(found, wanted):
    return max(abs(a - b) / (1 + abs(b)) for a, b in zip(found, wanted))


for t in range(len(columns["time"])):
    controller.set(controller.references("input"), [columns.get(f"{n}_demand", columns.get(n))[t] for n in demanded])
    controller.step(dt)
    commands = dict(zip(commanded, controller.get(controller.references("output"))))
    worst = max(worst, difference(commands.values(), [columns[n][t] for n in commands]))
    engine.set(engine.references("input"), [commands[n] if n in commands else columns[n][t] for n in moved])
    for _ in range(lead if t == 0 else 0):
        engine.step(dt)
    # A row holds what is measured before its inputs act.
    found = dict(zip(engine.names("output"), engine.get(engine.references("output"))))
    worst = max(worst, difference([found[n] for n in answered], [columns[n][t] for n in answered]))
    engine.step(dt)
controller.close()
engine.close()
print(f"FMI {engine.about.fmiVersion}: the map drives the engine over {len(columns['time'])} samples, {len(commanded)} commands and "
      f"{len(answered)} answers: difference {worst:.1e}")
assert worst < 1e-9, worst
