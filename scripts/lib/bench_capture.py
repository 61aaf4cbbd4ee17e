#!/usr/bin/env python3
"""Measures capture: omnihdrd as a process, an emulated camera on its USB, an emulated trigger line.

  scripts/bench capture                  ten frames a second for a minute, overload, a slow disk, views in time
  scripts/bench capture --seconds 600    for ten minutes (40 GB of disk at most, given back at the end)
  scripts/bench capture --rate 15        so many frames a second
  scripts/bench capture --only rate ...  only these phases: rate, overload, stress, views
  scripts/bench capture --directory DIR  where the sessions are written [the temporary directory]
  scripts/bench capture --json FILE      everything that was measured
  scripts/bench capture --require-must   exit with 1 when a "must" of tests/bench/targets.json is missed
  scripts/bench capture --no-build       run what build/release has

The table has every number beside what tests/bench/targets.json asks for. rate: raw frames of 1024 x 4608 from edge to
durable journal while the views of the same frames keep the processors busy. overload: edges at eight times the rate.
stress: a disk that takes a quarter of a second to synchronise, and four programs that compute; then both end.
views: from the trigger of the last position that a view needs, two on, to the view, 2048 x 1024. Run it on a machine with nothing else to
do: the emulated camera and bus compute on the same processors, and times are of the whole.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys

TOP = pathlib.Path(__file__).resolve().parent.parent.parent
METER = TOP / "build" / "release" / "tests" / "bench" / "capture" / "capture_meter"


def fail(message, code=1):
    print(f"scripts/bench capture: {message}", file=sys.stderr)
    sys.exit(code)


def build():
    for step in (["scripts/setup", "build", "libraries", "tests"], ["cmake", "--preset", "release"],
                 ["cmake", "--build", "--preset", "release", "--target", "capture_meter"]):
        done = subprocess.run(step, cwd=TOP, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            print(done.stdout[-4000:], done.stderr[-4000:], sep="", file=sys.stderr)
            fail(f"{' '.join(step)}: failed")


def value_at(report, path):
    value = report
    for key in path.split("."):
        if not isinstance(value, dict) or key not in value:
            return None
        value = value[key]
    return value if isinstance(value, (int, float)) else None


def verdict(bound, value):
    if bound is None:
        return "-", True
    if value is None:
        return f"<= {bound['most']:g}" if "most" in bound else f">= {bound['least']:g}", True
    met = value <= bound["most"] if "most" in bound else value >= bound["least"]
    sign = f"<= {bound['most']:g}" if "most" in bound else f">= {bound['least']:g}"
    return f"{sign} {'met' if met else 'MISSED'}", met


def main():
    parser = argparse.ArgumentParser(prog="scripts/bench capture", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--only", nargs="+", default=[], metavar="PHASE")
    parser.add_argument("--directory")
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--require-must", action="store_true")
    parser.add_argument("--no-build", action="store_true")
    options = parser.parse_args()
    if not options.no_build:
        build()
    command = [str(METER), "--seconds", str(options.seconds), "--rate", str(options.rate)]
    for phase in options.only:
        command += ["--only", phase]
    if options.directory:
        command += ["--directory", options.directory]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    try:
        report = json.loads(done.stdout)
    except ValueError:
        fail(f"capture_meter: exit code {done.returncode}")
    report["load_average"] = os.getloadavg()
    report["processors"] = os.cpu_count()
    if options.json:
        pathlib.Path(options.json).write_text(json.dumps(report, indent=1) + "\n")

    targets = json.loads((TOP / "tests" / "bench" / "targets.json").read_text())["capture"]
    rows, missed = [("what", "measured", "must", "goal")], []
    for target in targets:
        value = value_at(report, target["value"])
        if value is None:
            continue
        must, met = verdict(target.get("must"), value)
        goal, _ = verdict(target.get("goal"), value)
        if not met:
            missed.append(target["what"])
        rows.append((target["what"], f"{value:.4g}", must, goal))
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    for row in rows:
        print("  ".join(cell.rjust(w) if i == 1 else cell.ljust(w)
                        for i, (cell, w) in enumerate(zip(row, widths))).rstrip())
    for phase in ("rate", "overload", "stress"):
        reasons = report.get(phase, {}).get("account", {}).get("by_reason") or {}
        for reason, count in sorted(reasons.items(), key=lambda item: -item[1])[:5]:
            print(f"{phase}: {count} lost: {reason}")
    print(f"load average {report['load_average'][0]:.1f} on {report['processors']} processors")
    if done.returncode != 0:
        fail("not everything is accounted for")
    if options.require_must and missed:
        fail(f"must missed: {', '.join(missed)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
