"""`lmkit fleet`: a group of commands for many recordings."""

from __future__ import annotations

from lmkit.cli import fleet_maps, fleet_recordings
from lmkit.cli.command_group import command_group

HELP = "Map a site from the recordings of many robots."

app = command_group(
    HELP,
    {
        "scan": fleet_recordings.scan,
        "detect": fleet_recordings.detect,
        "survey": fleet_maps.survey,
        "track": fleet_maps.track,
        "report": fleet_maps.report,
    },
)
