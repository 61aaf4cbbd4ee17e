#!/usr/bin/env python3
"""scripts/lint finds what it is there to find: every rule is shown a violation planted in a small tree."""

import importlib.machinery
import importlib.util
import pathlib
import subprocess
import sys
import tempfile
import unittest

LINT = pathlib.Path(__file__).resolve().parents[2] / "scripts" / "lint"


def lint_module():
    sys.dont_write_bytecode = True  # beside a script without .py nobody looks for it
    loader = importlib.machinery.SourceFileLoader("omnihdr_lint", str(LINT))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("omnihdr_lint", loader))
    loader.exec_module(module)
    return module


# A tree that keeps every rule.
CLEAN = {
    "core/base/result.h": "#pragma once\n#include <string>\n",
    "core/image/image.h": '#pragma once\n#include "core/base/result.h"\n',
    "core/pose/pose_tracker.cc": '#include "core/image/image.h"\n',
    "core/pipeline/processor.cc": '#include "core/image/image.h"\n',
    "drivers/sim/camera.h": '#pragma once\n#include "core/image/image.h"\n',
    "drivers/all_drivers.cc": '#include "drivers/sim/camera.h"\n',
    "daemon/app.cc": '#include <spdlog/spdlog.h>\n#include "drivers/sim/camera.h"\n',
    "tests/unit/core/base/result_test.cc": '#include <gtest/gtest.h>\n#include "core/base/result.h"\n',
}


class Lint(unittest.TestCase):
    def lint(self, check, planted):
        """Exit code and output of one check over the clean tree with `planted` files in it."""
        with tempfile.TemporaryDirectory() as folder:
            for name, text in {**CLEAN, **planted}.items():
                path = pathlib.Path(folder, name)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
            done = subprocess.run([sys.executable, str(LINT), check, "--root", folder],
                                  capture_output=True, text=True, check=False, timeout=30)
            return done.returncode, done.stdout + done.stderr

    def assert_found(self, check, planted, *words):
        code, output = self.lint(check, planted)
        self.assertEqual(code, 1, output)
        for word in words:
            self.assertIn(word, output)

    def test_a_tree_that_keeps_the_rules_passes(self):
        for check in ("layers", "tree", "words"):
            code, output = self.lint(check, {})
            self.assertEqual(code, 0, output)

    def test_core_must_not_include_a_driver(self):
        self.assert_found("layers", {"core/image/x.cc": '#include "drivers/sim/camera.h"\n'},
                          "core/image/x.cc:1", "drivers")

    def test_a_driver_must_not_include_the_daemon(self):
        self.assert_found("layers", {"daemon/config.h": "#pragma once\n",
                                     "drivers/sim/x.cc": '\n#include "daemon/config.h"\n'},
                          "drivers/sim/x.cc:2", "daemon")

    def test_base_must_not_include_image(self):
        self.assert_found("layers", {"core/base/x.h": '#pragma once\n#include "core/image/image.h"\n'},
                          "core/base/x.h:2", "core/image")

    def test_pose_and_stereo_do_not_know_each_other(self):
        self.assert_found("layers", {"core/pose/pose.h": "#pragma once\n",
                                     "core/stereo/x.cc": '#include "core/pose/pose.h"\n'},
                          "core/stereo/x.cc:1")

    def test_one_driver_does_not_know_another(self):
        self.assert_found("layers", {"drivers/replay/x.cc": '#include "drivers/sim/camera.h"\n'},
                          "drivers/replay/x.cc:1")

    def test_the_iidc_driver_knows_its_transport_but_not_the_other_way_round(self):
        planted = {"drivers/usb/usb.h": "#pragma once\n",
                   "drivers/iidc/camera.h": '#pragma once\n#include "drivers/usb/usb.h"\n'}
        code, output = self.lint("layers", planted)
        self.assertEqual(code, 0, output)
        self.assert_found("layers", {**planted, "drivers/usb/x.cc": '#include "drivers/iidc/camera.h"\n'},
                          "drivers/usb/x.cc:1")

    def test_a_new_core_folder_must_be_given_its_place(self):
        self.assert_found("layers", {"core/magic/x.cc": '#include "core/base/result.h"\n'}, "core/magic")

    def test_core_does_not_log_and_knows_no_service(self):
        for header in ("spdlog/spdlog.h", "systemd/sd-daemon.h", "httplib.h", "libusb-1.0/libusb.h", "gpiod.h"):
            self.assert_found("layers", {"core/base/x.cc": f"#include <{header}>\n"}, header)

    def test_drivers_do_not_log(self):
        self.assert_found("layers", {"drivers/sim/x.cc": "#include <spdlog/spdlog.h>\n"}, "spdlog")

    def test_ceres_is_for_tests_only(self):
        self.assert_found("layers", {"core/stereo/x.cc": "#  include <ceres/ceres.h>\n"}, "ceres")

    def test_the_product_does_not_include_its_tests(self):
        self.assert_found("layers", {"tests/support/scene.h": "#pragma once\n",
                                     "core/base/x.cc": '#include "tests/support/scene.h"\n'},
                          "core/base/x.cc:1")

    def test_a_unit_test_of_core_builds_without_drivers(self):
        self.assert_found("layers", {"tests/unit/core/base/x_test.cc": '#include "drivers/sim/camera.h"\n'},
                          "tests/unit/core/base/x_test.cc:1")

    def test_an_include_that_does_not_exist_is_named(self):
        self.assert_found("layers", {"core/base/x.cc": '#include "result.h"\n'}, '"result.h"')

    def test_a_stray_at_the_top_level_is_found(self):
        self.assert_found("tree", {"notes.txt": "hello\n"}, "notes.txt")

    def test_a_header_without_pragma_once_is_found(self):
        self.assert_found("tree", {"core/base/x.h": "int x();\n"}, "core/base/x.h")

    def test_marks_of_unfinished_work_and_foreign_paths_are_found(self):
        self.assert_found("words", {"core/base/x.cc": "int x;\n// TO" + "DO: more\n"}, "core/base/x.cc:2")
        self.assert_found("words", {"scripts/x": "cd /ho" + "me/somebody/omnihdr\n"}, "scripts/x:1")

    def test_two_types_of_one_name_are_found_unless_nobody_else_sees_them(self):
        own = "namespace omnihdr {\nstruct Line {\n  int a;\n};\n}  // namespace omnihdr\n"
        hidden = "namespace omnihdr {\nnamespace {\nstruct Line {\n};\n}  // namespace\n}  // namespace omnihdr\n"
        other = own.replace("omnihdr {", "omnihdr::sim {")
        self.assert_found("types", {"core/base/a.h": own, "daemon/b.h": own}, "daemon/b.h:2", "core/base/a.h:2")
        self.assertEqual(self.lint("types", {"core/base/a.h": own, "daemon/b.cc": hidden, "drivers/c.h": other})[0], 0)

    def test_tidy_looks_at_changed_files_and_at_headers_through_one_file_each(self):
        closures = {
            "core/a.cc": {"core/a.cc", "core/a.h", "core/everywhere.h"},
            "core/b.cc": {"core/b.cc", "core/everywhere.h"},
            "core/c.cc": {"core/c.cc", "core/a.h", "core/b.h", "core/everywhere.h"},
        }
        look = lint_module().files_to_look_at
        self.assertEqual(look(closures, {"core/b.cc", "README.md"}), {"core/b.cc"})
        self.assertEqual(look(closures, {"core/a.h"}), {"core/a.cc"})  # its own file
        self.assertEqual(look(closures, {"core/everywhere.h"}), {"core/b.cc"})  # the shortest to read
        self.assertEqual(look(closures, {"core/c.cc", "core/everywhere.h"}), {"core/c.cc"})  # seen there already
        self.assertEqual(look(closures, {"core/nowhere.h"}), set())


if __name__ == "__main__":
    unittest.main()
