"""Help texts name values by what they are, not by Python types."""

from __future__ import annotations

import re

import pytest
from command_line import run_command

from lmkit.cli.app import public_commands


@pytest.mark.parametrize("command", public_commands())
def test_values_are_named_in_help_texts(command):
    text = run_command(*command.split(), "--help").out
    assert not re.search(r"<(str|int|float|path|list)|list\[|\{\w+\}\.\.\.", text)


def test_files_folders_and_numbers_have_names_of_their_own():
    words = " ".join(run_command("simulate", "--help").out.split())
    assert "-o, --output FOLDER" in words
    assert "--seed N" in words
    assert "lmkit verify [OPTIONS] FILE..." in run_command("verify", "--help").out
    assert "lmkit calibrate [OPTIONS] [IMAGE]..." in run_command("calibrate", "--help").out
