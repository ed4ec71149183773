#!/usr/bin/env python3
"""Draw docs/overview.svg from the folder of a finished `dynocal calibrate` run.

    docs/overview.py runs/gtdi > docs/overview.svg

Above the chain, below what it is for: 30 to 70 Nm steps at constant speed, the delivered dynamic map against the static
map. Every number and curve is read from the run. Only the standard library is used.
"""

import csv
import html
import json
import pathlib
import sys

SCENARIO = "30 to 70 Nm steps"
MAPS = [("dynamic map", "#0b6e99", 1.8), ("static map", "#c2571a", 1.4)]
STEPS = [
    ("excite", ["engine or bed,", "closed loop"]), ("identify", ["polynomial", "NARX models"]),
    ("design", ["optimal test", "signal"]), ("optimise", ["fuel over a", "whole record"]),
    ("invert", ["dynamic map"]), ("validate", ["on the engine,", "against rivals"]),
]
WIDTH, SPAN_S = 960, 13.0


def column(rows, start):
    return [float(r[next(k for k in r if k.split(" ")[0] == start)]) for r in rows]


def read(run):
    """Map name -> (time, torque, lambda, demand) of the step scenario, and map name -> its scores."""
    folder = pathlib.Path(run, "steps/06-validate")
    result = json.loads((folder / "step.json").read_text(encoding="utf-8"))["result"]
    curves = {}
    for record in result["records"]:
        name, _, scenario = record["name"].partition(", ")
        if scenario.startswith(SCENARIO):
            with (folder / record["file"]).open(encoding="utf-8", newline="") as file:
                rows = list(csv.DictReader(file))
            curves[name] = [column(rows, c) for c in ("time", "torque", "lambda", "torque_demand")]
    scores = {s["map"]: s for s in result["scores"] if s["scenario"].startswith(SCENARIO)}
    return curves, scores


def text(x, y, words, size=13, fill="#333", anchor="start", weight="normal"):
    return (f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{fill}" text-anchor="{anchor}" '
            f'font-weight="{weight}">{html.escape(words)}</text>')


def chain():
    parts, width, gap = [], 132, 25
    for k, (name, lines) in enumerate(STEPS):
        x = 20 + k * (width + gap)
        parts.append(f'<rect x="{x}" y="18" width="{width}" height="72" rx="6" fill="#eef4f7" stroke="#0b6e99"/>')
        parts.append(text(x + width / 2, 40, f"{k + 1} {name}", 15, "#0b6e99", "middle", "bold"))
        parts += [text(x + width / 2, 59 + 17 * i, line, 12, anchor="middle") for i, line in enumerate(lines)]
        if k + 1 < len(STEPS):
            parts.append(f'<path d="M{x + width + 4},54 h{gap - 8} m-6,-4 l6,4 l-6,4" fill="none" stroke="#555"/>')
    # The second pass: measured optimum, models estimated again, optimised again.
    x1, x2 = 20 + 1.5 * width + gap, 20 + 3.5 * width + 3 * gap
    parts.append(f'<path d="M{x2},92 v14 H{x1} v-12 m-4,6 l4,-6 l4,6" fill="none" stroke="#555" stroke-dasharray="4 3"/>')
    parts.append(text((x1 + x2) / 2, 121, "measured again, identified again", 12, "#555", "middle"))
    return parts


def ticks(low, high, step):
    k = round(low / step)
    while k * step <= high + 1e-9:
        yield k * step
        k += 1


def panel(x0, title, unit, low, high, step, lines, start):
    """One plot: `lines` is a list of (time, values, colour, width, dashes)."""
    y0, w, h, parts = 178, 400, 210, []
    sx, sy = (lambda t: x0 + (t - start) / SPAN_S * w), (lambda v: y0 + h - (v - low) / (high - low) * h)
    parts.append(text(x0, y0 - 14, f"{title} [{unit}]", 14, weight="bold"))
    for v in ticks(low, high, step):
        parts.append(f'<path d="M{x0},{sy(v):.1f} h{w}" stroke="#ddd"/>')
        parts.append(text(x0 - 7, sy(v) + 4, f"{v:g}" if step >= 1 else f"{v:.2f}", 12, anchor="end"))
    for k in range(0, int(SPAN_S) + 1, 2):
        parts.append(text(sx(start + k), y0 + h + 18, str(k), 12, anchor="middle"))
    parts.append(text(x0 + w / 2, y0 + h + 36, "time [s]", 12, anchor="middle"))
    for time, values, colour, width, dashes in lines:
        points = [f"{sx(t):.1f},{sy(min(max(v, low), high)):.1f}" for t, v in zip(time, values) if start <= t <= start + SPAN_S]
        parts.append(f'<polyline points="{" ".join(points)}" fill="none" stroke="{colour}" stroke-width="{width}" '
                     f'stroke-dasharray="{dashes}" stroke-linejoin="round"/>')
    return parts


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    curves, scores = read(sys.argv[1])
    time, _, _, demand = curves[MAPS[0][0]]
    # One step up and one down: the window starts 1 s before the first change of the demand.
    changes = [t for t, a, b in zip(time[1:], demand, demand[1:]) if a != b]
    start = max(changes[0] - 1.0, 0.0)
    torque, lambdas = [(time, demand, "#999", 1.2, "5 3")], []
    for name, colour, width in MAPS:
        t, y, lam, _ = curves[name]
        torque.append((t, y, colour, width, ""))
        lambdas.append((t, lam, colour, width, ""))
    shown = [v for ts, vs, *_ in lambdas for t, v in zip(ts, vs) if start <= t <= start + SPAN_S]
    step = 0.1
    low, high = (step * (min(shown) // step)), (step * (max(shown) // step + 1))
    parts = chain()
    parts += panel(60, "Torque", "Nm", 20, 80, 10, torque, start)
    parts += panel(535, "Lambda", "-", low, high, step, lambdas, start)
    x = 60
    for name, colour, dashes in [("demand", "#999", "5 3")] + [(n, c, "") for n, c, _ in MAPS]:
        label = name
        if name in scores:
            held = next(d for d in scores[name]["demands"] if d["output"] == "lambda")
            spike = max(held["spike_above"], held["spike_below"])
            label += f": lambda off by {spike:.3f} at most, {scores[name]['economy']:.2f} Nm/mg"
        parts.append(f'<path d="M{x},449 h26" stroke="{colour}" stroke-width="2.5" stroke-dasharray="{dashes}"/>')
        parts.append(text(x + 33, 453, label, 12))
        x += 100 if name == "demand" else 395
    print(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} 470" width="{WIDTH}" height="470" '
          'font-family="Helvetica, Arial, sans-serif" role="img" aria-label="The chain, and a dynamic map against a '
          'static map on torque steps"><rect width="100%" height="100%" fill="white"/>')
    print("\n".join(parts) + "\n</svg>")


if __name__ == "__main__":
    main()
