"""`lmkit plan`: a group of commands."""

from __future__ import annotations

from lmkit.cli import plan_coverage, plan_place, plan_route, plan_sheet
from lmkit.cli.command_group import command_group

HELP = "Plan landmark positions, accuracy and routes."

app = command_group(
    HELP,
    {
        "coverage": plan_coverage.run,
        "place": plan_place.run,
        "route": plan_route.run,
        "sheet": plan_sheet.run,
    },
)
