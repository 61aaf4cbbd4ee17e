#!/usr/bin/env python3
"""Manual pages and completions know every command, option and key that the programs have.

    manual_test.py BUILD
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import unittest

TOP = pathlib.Path(__file__).resolve().parents[2]
BUILD = pathlib.Path(sys.argv.pop() if len(sys.argv) > 1 else "build/release").resolve()
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "OMNIHDR_SOCKET"}


def run(*command):
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60, env=ENVIRONMENT).stdout


def help_of(program, *command):
    """What --help lists: (commands, options). Long descriptions stand on lines of their own, deeper."""
    commands, options, part = [], [], ""
    for line in run(BUILD / "bin" / program, *command, "--help").splitlines():
        if re.match(r"\S.*:$", line):
            part = line
        elif match := re.match(r"  (\S+)", line):
            if part == "Subcommands:":
                commands.append(match.group(1))
            elif match.group(1).startswith("-"):
                options += match.group(1).split(",")
    return commands, options


def leaves(*command):
    """{command: options} of every command that has none below it."""
    commands, options = help_of("omnihdr", *command)
    if not commands:
        return {" ".join(command): options}
    return {name: found for below in commands for name, found in leaves(*command, below).items()}


LEAVES = leaves()


def plain(roff):
    return re.sub(r"\\f[BRI]", "", roff).replace("\\-", "-").replace("\\&", "").replace("\\e", "\\")


def page(name):
    return (BUILD / "systemd" / name).read_text(encoding="utf-8")


def completed(*words):
    """What bash offers for the last word."""
    script = BUILD / "systemd/omnihdr.bash" if words[0] == "omnihdr" else TOP / "systemd/completion/omnihdrd"
    quoted = " ".join(f"'{word}'" for word in words)
    answer = run("bash", "-c", f'source {script}; COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; _{words[0]}; '
                 'echo "${COMPREPLY[@]}"')
    return answer.split()


class Manual(unittest.TestCase):
    def test_there_are_commands_below_commands(self):
        self.assertIn("calibrate response", LEAVES)
        self.assertGreater(len(LEAVES), 30)

    def test_every_command_has_its_section_with_every_option(self):
        sections = {}
        for part in re.split(r"(?m)^\.SS ", page("omnihdr.1"))[1:]:
            head, body = part.split("\n", 1)
            name = re.match(r"omnihdr ([a-z\- ]+[a-z])", plain(head.strip('"'))).group(1)
            sections[name] = plain(body)
        self.assertEqual(set(sections), set(LEAVES))
        for command, options in LEAVES.items():
            for option in options:
                if option not in ("-h", "--help"):
                    self.assertRegex(sections[command], rf"(?m)^([^\n]* )?{option}[ ,\n]", command)

    def test_the_page_of_the_daemon_has_every_option(self):
        text = plain(page("omnihdrd.8"))
        for option in help_of("omnihdrd")[1]:
            self.assertRegex(text, rf"(?m)^([^\n]* )?{option}[ ,\n]")
        # And none that it has not.
        told = re.search(r"\.SH OPTIONS\n(.*?)\.SH", text, re.DOTALL).group(1)
        self.assertEqual(set(re.findall(r"(?m)(?<![\w-])--?[a-z]+", told)), set(help_of("omnihdrd")[1]))

    def test_the_page_of_the_configuration_has_every_key_and_default(self):
        text = plain(page("omnihdr.toml.5"))
        section = None
        for line in (TOP / "config/omnihdr.toml").read_text(encoding="utf-8").splitlines():
            if match := re.fullmatch(r"\[(.*)\]", line):
                section = text[text.index(f".SH [{match.group(1)}]\n"):].split("\n.SH ")[0] + "\n"
            elif match := re.match(r"[a-z0-9_]+ = [^\[]+$", line):
                self.assertIn(f"\n{match.group(0)}\n", section.replace("\\e", "\\"))
            elif match := re.match(r"([a-z0-9_]+ =) \[", line):
                self.assertIn(f"\n{match.group(1)} [", section)

    def test_the_page_of_the_session_has_every_status_of_a_frame(self):
        source = (TOP / "core/session/session.cc").read_text(encoding="utf-8")
        words = re.findall(r"case FrameStatus::\w+:\s*return \"([a-z-]+)\"", source)
        self.assertGreater(len(words), 5)
        for word in words:
            self.assertIn(f'"{word}"', plain(page("omnihdr-session.5")))

    def test_the_pages_are_without_warnings(self):
        if not shutil.which("groff"):
            self.skipTest("groff is not installed")
        for name in ("omnihdr.1", "omnihdr.toml.5", "omnihdr-session.5", "omnihdrd.8"):
            done = subprocess.run(["groff", "-man", "-Tutf8", "-Kutf8", "-ww", "-z", BUILD / "systemd" / name],
                                  capture_output=True, text=True, check=False, timeout=60)
            self.assertEqual((done.returncode, done.stderr), (0, ""), name)


class Completion(unittest.TestCase):
    def test_it_offers_every_command(self):
        self.assertEqual(set(completed("omnihdr", "")), {command.split()[0] for command in LEAVES})
        self.assertEqual(set(completed("omnihdr", "calibrate", "")),
                         {command.split()[1] for command in LEAVES if command.startswith("calibrate ")})

    def test_it_offers_every_option_of_every_command(self):
        for command, options in LEAVES.items():
            self.assertEqual(set(completed("omnihdr", *command.split(), "-")), set(options), command)

    def test_it_offers_an_options_choices_and_nothing_where_a_file_is_wanted(self):
        self.assertEqual(completed("omnihdr", "process", "--mode", ""), ["auto", "spatiotemporal", "temporal"])
        self.assertEqual(completed("omnihdr", "process", "--mode", "te"), ["temporal"])
        self.assertEqual(completed("omnihdr", "process", "--mask", ""), [])

    def test_it_offers_every_option_of_the_daemon(self):
        self.assertEqual(set(completed("omnihdrd", "-")), set(help_of("omnihdrd")[1]))


if __name__ == "__main__":
    unittest.main()
