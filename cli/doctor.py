"""`clikgen doctor`: compiler, versions, cache; what works here and what to do."""

from typing import Annotated

import typer


def command(as_json: Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")] = False) -> int:
    """Check this machine; exit 1 when something that clikgen needs does not work."""
    from clikgen.cli.terminal import print_json, print_table
    from clikgen.runtime.checkup import checkup

    findings = checkup()
    if as_json:
        print_json([{"what": f.what, "found": f.found, "works": f.works, "advice": f.advice} for f in findings])
    else:
        print_table(
            "clikgen doctor",
            ["what", "found", "works", "what to do"],
            [[f.what, f.found, "yes" if f.works else "NO", f.advice] for f in findings],
        )
    return 0 if all(finding.works for finding in findings) else 1
