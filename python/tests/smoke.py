"""What an installation with numpy alone must do; run by itself, without pytest."""

import sys

import numpy

import needle_steer as ns

QUICK = {"run.sensor": "shape", "target.depth_mm": 15, "target.offset_mm": 0.5}


class Straight:
    def decide(self, view):
        return view.screw(view.insertion_speed, 0.0)


def main():
    run = ns.run(seed=3, set=QUICK)
    assert run.ended == "target passed" and run.summary["true_error_mm"] < 0.5
    assert numpy.isfinite(run.series["t_s"]).all()
    own, built_in = (ns.run(seed=3, law=law, set=QUICK) for law in [Straight(), "none"])
    assert own.summary["true_error_mm"] == built_in.summary["true_error_mm"]
    assert ns.NeedleModel().shape(20).shape == (20, 3)
    try:
        ns.config(set={"target.offset": 1})
    except ns.InputError as error:
        assert "offset_mm" in str(error)
    else:
        raise AssertionError("an unknown key was taken")
    print(f"Python {sys.version.split()[0]}, numpy {numpy.__version__}: {run!r}")


if __name__ == "__main__":
    main()
