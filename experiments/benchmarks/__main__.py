"""Run benchmarks: `python -m experiments.benchmarks [name ...] [--quick]`."""

import argparse
import importlib
import time

NAMES = (
    *("evaluation", "variants", "gradients", "gcc", "compile_time", "import_time", "single_call"),
    *("simulate", "simulation_gradient", "scaling", "gpu", "identification", "optimization", "scale"),
)


def main() -> None:
    """Run those that are named, or all."""
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks", description="Benchmarks; results go to results/.")
    parser.add_argument("names", nargs="*", metavar="name", help=f"one of {', '.join(NAMES)}; all without")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions and smaller sizes")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(NAMES):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    for name in arguments.names or NAMES:
        start = time.perf_counter()
        print(f"\n## {name}", flush=True)
        importlib.import_module(f"experiments.benchmarks.{name}").run(arguments.quick)
        print(f"\n({time.perf_counter() - start:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
