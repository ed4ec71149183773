"""Steady points: response models with left-out errors, from a table of an engine."""

from pathlib import Path

import dynocal

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "steady"


def main() -> None:
    done = dynocal.identify(FOLDER / "engine_points.toml")
    print(done)
    print(done.verdict)
    for name, model in done.models.items():
        print(name, "from", ", ".join(model.inputs), "by", model.kind)


if __name__ == "__main__":
    main()
