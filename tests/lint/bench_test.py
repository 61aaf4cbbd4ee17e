#!/usr/bin/env python3
"""scripts/bench pairs, divides and judges as it says: fed by programs that print known times."""

import contextlib
import importlib.machinery
import importlib.util
import io
import json
import pathlib
import stat
import sys
import tempfile
import unittest
from unittest import mock

TOP = pathlib.Path(__file__).resolve().parents[2]


def load_bench():
    sys.dont_write_bytecode = True  # scripts/bench has no suffix: its cache would lie in the tree
    loader = importlib.machinery.SourceFileLoader("bench", str(TOP / "scripts" / "bench"))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("bench", loader))
    loader.exec_module(module)
    return module


bench = load_bench()
COUNTERS = {}  # by name, what a benchmark reports beside its time


def benchmarks(times):
    """Google Benchmark's report: {name: CPU times in µs}, the wall clock twice as long."""
    runs = [{"name": f"{name}/process_time/real_time", "run_type": "iteration", "time_unit": "us", "cpu_time": t,
             "real_time": 2.0 * t, **({"rms": COUNTERS[name]} if name in COUNTERS else {})} for name, values in times.items() for t in values]
    runs.append({"name": "Fast/omnihdr_mean", "run_type": "aggregate", "time_unit": "us", "cpu_time": 1e9,
                 "real_time": 1e9})
    return json.dumps({"benchmarks": runs})


class Bench(unittest.TestCase):
    def run_bench(self, times, targets, *arguments):
        """Exit code, standard output and the JSON report of a run over one program with these times."""
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            program = root / "build" / "bench" / "tests" / "bench" / "some_bench"
            program.parent.mkdir(parents=True)
            (root / "report.json").write_text(benchmarks(times))
            program.write_text("#!/bin/sh\nfor a; do case $a in --benchmark_out=*) "
                               f"cp {root}/report.json \"${{a#*=}}\";; esac; done\n"
                               + "".join(f"echo {name}\n" for name in times))
            program.chmod(program.stat().st_mode | stat.S_IXUSR)
            (root / "tests" / "bench").mkdir(parents=True)
            (root / "tests" / "bench" / "targets.json").write_text(json.dumps({"targets": targets}))
            code, out, err = 0, io.StringIO(), io.StringIO()
            with mock.patch.object(bench, "TOP", root), \
                 mock.patch.object(bench, "BUILD", root / "build" / "bench"), \
                 mock.patch.object(bench.shutil, "which", lambda name: None), \
                 mock.patch.object(sys, "argv", ["bench", "--no-build", "--json", str(root / "out.json"), *arguments]), \
                 contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                try:
                    code = bench.main()
                except SystemExit as end:
                    code = end.code
            report = root / "out.json"
            return code, out.getvalue() + err.getvalue(), json.loads(report.read_text()) if report.exists() else None

    TIMES = {"Fast/omnihdr": [1000, 900, 5000, 1000, 1100], "Fast/peer": [4000, 8000, 4000, 4100, 3000]}

    def test_the_ratio_is_that_of_the_medians_of_cpu_time(self):
        code, text, report = self.run_bench(self.TIMES, [])
        self.assertEqual(code, 0, text)
        row = report["rows"][0]
        self.assertAlmostEqual(row["ours"]["cpu_ms"], 1.0)
        self.assertAlmostEqual(row["ours"]["wall_ms"], 2.0)
        self.assertAlmostEqual(row["peers"][0]["ratio_cpu"], 4.0)
        self.assertIn("4.00", text)

    def test_a_must_is_met_or_missed_by_its_peer(self):
        for wanted, verdict, exit_code in ((4, "met", 0), (4.5, "MISSED", 1)):
            targets = [{"subject": "Fast", "must": {"peer": "peer", "ratio": wanted}}]
            code, text, report = self.run_bench(self.TIMES, targets, "--require-must")
            self.assertEqual(code, exit_code, text)
            self.assertIn(f">= {wanted:g} {verdict}", text)
            self.assertEqual(report["rows"][0]["must"]["met"], verdict == "met")

    def test_what_could_not_be_measured_is_not_met(self):
        targets = [{"subject": "Slow", "must": {"peer": "peer", "ratio": 1}},
                   {"subject": "Fast", "must": {"peer": "stranger", "ratio": 1}}]
        code, text, _ = self.run_bench(self.TIMES, targets, "--require-must")
        self.assertEqual(code, 1)
        self.assertIn("Slow: must >= 1 against peer: not measured", text)
        self.assertIn("Fast: must >= 1 against stranger: not measured", text)
        self.assertEqual(self.run_bench(self.TIMES, targets)[0], 0, "only --require-must fails")

    def test_a_missed_goal_is_told_and_fails_nothing(self):
        targets = [{"subject": "Fast", "must": {"peer": "peer", "ratio": 2}, "goal": {"peer": "peer", "ratio": 9}}]
        code, text, _ = self.run_bench(self.TIMES, targets, "--require-must")
        self.assertEqual(code, 0)
        self.assertIn(">= 9 MISSED", text)

    def test_a_quality_is_a_counter_that_must_not_be_larger(self):
        with mock.patch(__name__ + ".COUNTERS", {"Error/omnihdr": 0.03, "Error/peer": 0.05}):
            for most, verdict, exit_code in ((0.03, "met", 0), (0.02, "MISSED", 1)):
                targets = [{"subject": "Error", "value": "rms", "must": {"most": most}}]
                code, text, report = self.run_bench({"Error/omnihdr": [1], "Error/peer": [1]}, targets,
                                                    "--require-must")
                self.assertEqual(code, exit_code, text)
                self.assertIn(f"0.03; must <= {most:g} {verdict}, peer 0.05", text)
                self.assertEqual(report["rows"][0]["must"]["measured"], 0.03)
        targets = [{"subject": "Error", "value": "rms", "must": {"most": 1}}]
        code, text, _ = self.run_bench({"Error/omnihdr": [1]}, targets, "--require-must")
        self.assertEqual(code, 1, "a counter that is not there is not met: " + text)
        self.assertIn("not measured; must <= 1\n", text)

    def test_a_quality_may_have_to_be_as_good_as_the_best_peer_of_the_run(self):
        times = {"Error/omnihdr": [1], "Error/good": [1], "Error/bad": [1]}
        targets = [{"subject": "Error", "value": "rms", "must": {"best_peer": True}}]
        for ours, verdict, exit_code in ((0.05, "met", 0), (0.06, "MISSED", 1)):
            with mock.patch(__name__ + ".COUNTERS", {"Error/omnihdr": ours, "Error/good": 0.05, "Error/bad": 0.1}):
                code, text, _ = self.run_bench(times, targets, "--require-must")
                self.assertEqual(code, exit_code, text)
                self.assertIn(f"must <= 0.05 {verdict}", text)

    def test_what_is_optional_may_be_missing(self):
        targets = [{"subject": "Walk", "optional": True, "must": {"peer": "peer", "ratio": 2}}]
        code, text, _ = self.run_bench(self.TIMES, targets, "--require-must")
        self.assertEqual(code, 0, text)
        self.assertNotIn("Walk", text)

    def test_a_peer_that_is_not_installed_is_named(self):
        times = {"ToneMap/omnihdr": [10] * 5}
        code, text, _ = self.run_bench(times, [])
        self.assertEqual(code, 0, text)
        self.assertIn("pfstmo_reinhard02: not installed", text)

    def test_wrong_arguments_are_refused(self):
        for arguments in (["--repetitions", "2"], ["--min-time", "0"], ["--only", "Nothing"]):
            code, text, _ = self.run_bench(self.TIMES, [], *arguments)
            self.assertEqual(code, 64, text)

    def test_the_targets_of_the_tree_can_be_read(self):
        targets = json.loads((TOP / "tests" / "bench" / "targets.json").read_text())["targets"]
        self.assertTrue(targets)
        for target in targets:
            self.assertIn("subject", target)
            for kind in ("must", "goal"):
                if kind in target:
                    if "best_peer" in target[kind]:
                        continue
                    self.assertGreater(target[kind]["most" if "value" in target else "ratio"], 0)
                    self.assertEqual("peer" in target[kind], "value" not in target)


if __name__ == "__main__":
    unittest.main()
