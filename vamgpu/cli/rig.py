"""``vam rig``: the parts of a rig, and what their combination guarantees, watches and only believes."""

from __future__ import annotations

from cyclopts import App
from rich.markup import escape

from vamgpu.cli.commands import app
from vamgpu.cli.options import Settings, console

group: App = App(name="rig", help="Check a rig file without touching a machine.")
app.command(group)
ROLES = ("motion", "clock", "display", "light", "lens", "lift", "feedback")


@group.command
def check(rig: str, /, *, speed: str | None = None, settings: Settings = None) -> int:
    """List the parts that fill the roles of a rig, and what is guaranteed, watched by a sensor, or only believed.

    Args:
        rig: the TOML file of the rig, or emulated
        speed: speed of vials [deg/s], 40 by default, or of webs [mm/s], 1 by default; or with a unit, such as "9 rpm"
    """
    from vamgpu.hosts.rigs.config import read_rig
    from vamgpu.hosts.rigs.guarantees import driver_of, guarantees, part, refused
    from vamgpu.hosts.rigs.planning import speed_of

    screen, setup = console(), read_rig(rig, settings or ()).setup
    for role in ROLES:
        parts = getattr(setup, role)
        names = ", ".join(driver_of(part) for part in (parts if isinstance(parts, tuple) else (parts,)) if part)
        screen.print(f"  {role:<12} [bold]{escape(names or 'none')}[/]")
    unit = "deg" if setup.rig.machine in ("vial", "any") else "mm"
    found = guarantees(setup, speed_of(speed, "vial" if unit == "deg" else "web", 1.0), unit)
    for one in (*found, *([part(setup, lifted=True)] if setup.lift else ())):
        screen.print(f"  {one.about:<12} [{'green' if one.holds else 'yellow'}]{escape(str(one))}[/]")
    if refused(found, setup):
        screen.print(f"  {'refused':<12} [red]\\[safety] accepts drift = {setup.safety.drift:g}[/]")
        return 1
    return 0
