"""From a measured file to a model with honest scores: the gas furnace of Box and Jenkins."""

from pathlib import Path

import dynocal

FILE = Path(__file__).resolve().parents[2] / "examples" / "gas_furnace" / "gas_furnace.csv.gz"


def main() -> None:
    data = dynocal.read(
        FILE,
        {"gas_rate": "gas_rate_cuft_min", "co2": "co2_percent"},
        ts_s=9.0,
        outputs="co2",
        init_samples=5,
    )
    train, test = data.split(fraction=0.5)
    fitted = dynocal.Arx(na=2, nb=2, nk=3, estimator="sem").fit(train)
    print(repr(fitted.model_))
    print(fitted.score(train))
    print(fitted.score(test, k_steps=[5]))


if __name__ == "__main__":
    main()
