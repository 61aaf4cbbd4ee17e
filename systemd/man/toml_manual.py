#!/usr/bin/env python3
"""Writes omnihdr.toml(5) from config/omnihdr.toml, whose comments document every key.

    systemd/man/toml_manual.py VERSION <config/omnihdr.toml >omnihdr.toml.5
"""

import re
import sys


def roff(text):
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return "\\&" + text if text[:1] in ".'" else text


def page(version, lines):
    """The comment lines above a key belong to it and to the keys right below it that have none of their own; those
    before the first section are the introduction. A comment with deeper lines in it keeps its lines."""
    out = [f'.\\" Made from config/omnihdr.toml.\n.TH OMNIHDR.TOML 5 "" "omnihdr {version}" "File Formats"',
           ".SH NAME\nomnihdr.toml \\- configuration of omnihdrd and omnihdr",
           ".SH SYNOPSIS\n.I /etc/omnihdr/omnihdr.toml\n.br\n.I /etc/omnihdr/omnihdr.d/*.toml\n.SH DESCRIPTION"]
    comment, keys, section = [], [], ""

    def flush():
        nonlocal comment, keys
        if keys:
            for number, key in enumerate(keys):
                out.append((".TP" if number == 0 else ".TQ") + f"\n\\fB{roff(key)}\\fR")
        if comment:
            for number, line in enumerate(comment):
                if number and line.startswith("  "):
                    out.append(".br")
                out.append(roff(line.strip()))
        comment, keys = [], []

    waiting = []  # comment lines not yet given to a key
    for line in lines:
        line = line.rstrip("\n")
        if line.startswith("#"):
            if keys:
                flush()
            waiting.append(line[2:])
        elif match := re.fullmatch(r"\[([a-z0-9_.]+)\]", line):
            flush()
            if waiting:
                comment, waiting = waiting, []
                flush()
            if not section:
                out.append(".PP\nThe values below are the defaults.")
            section = match.group(1)
            out.append(f".SH [{section}]")
        elif match := re.match(r"([a-z0-9_]+) = (.*)", line):
            if waiting:
                comment, waiting = waiting, []
            keys.append(f"{match.group(1)} = {match.group(2)}")
        elif not line:
            flush()
            if waiting and not section:
                comment, waiting = waiting, []
                flush()
        elif keys and re.match(r"[\s\]]", line):  # a list over several lines
            keys[-1] += " " + line.strip()
        else:
            raise SystemExit(f"toml_manual.py: cannot read: {line}")
    flush()
    out.append(".SH SEE ALSO\n.BR omnihdrd (8),\n.BR omnihdr (1)")
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    sys.stdout.reconfigure(encoding="utf-8")
    sys.stdin.reconfigure(encoding="utf-8")
    sys.stdout.write(page(sys.argv[1], sys.stdin.readlines()))
