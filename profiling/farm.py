"""What a farm of printers needs a day: printers, machines that compute, storage, network, money.

    python profiling/farm.py --prints 10 1000 100000
    python profiling/farm.py --solve 310 --prove 121 --folder 0.494 --print 120        # another job

Defaults are a gyroid of 128³ voxels, 360 angles and 40 evaluations: processor seconds and bytes as measured by
`memory.py` (`records/memory-cpu-128.json`). Everything else is assumed, and an option.
"""

from __future__ import annotations

import argparse

DAY = 86400.0
MEASURED = {
    "solve": (6.1, "seconds a job takes of two processor cores, from start to folder, voxels included"),
    "prove": (1.7, "seconds its proof takes of them"),
    "folder": (0.031, "gigabytes of its folder"),
    "page": (0.0017, "gigabytes of its report"),
}
ASSUMED = {
    "print": (60.0, "seconds of light a print takes"),
    "handling": (240.0, "seconds a printer waits for its next vial"),
    "uptime": (0.8, "share of the day that printers run"),
    "keep": (30.0, "days that folders are kept"),
    "power": (0.15, "kilowatts a printer takes"),
    "energy": (0.25, "price of a kilowatt hour"),
    "core_hour": (0.04, "price of a processor core for an hour"),
    "gigabyte_month": (0.02, "price of a gigabyte kept for a month"),
    "printer": (30000.0, "price of a printer"),
    "years": (4.0, "years it lasts"),
    "resin": (1.50, "price of the resin in a vial"),
    "hands": (0.50, "price of the hands that change a vial"),
}


def farm(prints: float, a: argparse.Namespace) -> dict[str, float]:
    """What so many prints a day need and what one costs."""
    cycle = a.print + a.handling
    printers = -(-prints * cycle // (DAY * a.uptime))
    cores = 2.0 * prints * (a.solve + a.prove) / DAY
    written = prints * (a.folder + a.page)
    computing = 2.0 * (a.solve + a.prove) / 3600 * a.core_hour
    keeping = (a.folder + a.page) * a.keep / 30.4 * a.gigabyte_month
    light = a.power * cycle / 3600 * a.energy
    machine = printers * a.printer / (a.years * 365 * prints)
    return {
        "printers": printers,
        "busy cores": cores,
        "written a day [GB]": written,
        "kept [TB]": written * a.keep / 1000,
        "to printers [MB/s]": 1000 * prints * a.folder / (DAY * a.uptime),
        "computing": computing,
        "keeping": keeping,
        "energy": light,
        "machine": machine,
        "a print": computing + keeping + light + machine + a.resin + a.hands,
    }


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--prints", type=float, nargs="+", default=[10, 1000, 100_000], help="a day")
    for name, (value, said) in {**MEASURED, **ASSUMED}.items():
        options.add_argument(f"--{name.replace('_', '-')}", type=float, default=value, help=f"{said} ({value:g})")
    asked = options.parse_args()
    rows = [farm(prints, asked) for prints in asked.prints]
    print("| prints a day | " + " | ".join(f"{prints:,.0f}" for prints in asked.prints) + " |")
    print("|---|" + "---:|" * len(rows))
    for name in rows[0]:
        print(f"| {name} | " + " | ".join(f"{row[name]:,.3g}" for row in rows) + " |")


if __name__ == "__main__":
    main()
