"""`lmkit doctor`: is this installation sound?"""

from __future__ import annotations

from lmkit.cli.common import print_line
from lmkit.errors import NegativeAnswer


def run() -> None:
    """Check the installation: versions, OpenCV doubles, templates."""
    from lmkit.installation import check_installation

    findings = check_installation()
    for finding in findings:
        print_line(f"{'ok  ' if finding.good else 'BAD '} {finding.text}")
    bad = [finding for finding in findings if not finding.good]
    if bad:
        raise NegativeAnswer("unsound", f"{len(bad)} of {len(findings)} checks fail", bad[0].hint)
