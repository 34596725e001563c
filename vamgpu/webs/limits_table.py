"""The limits of a web machine as lines of text."""

from __future__ import annotations

from math import degrees, inf

from vamgpu.printing.proof import Line
from vamgpu.units import Pa_s
from vamgpu.webs.limits import WebLimits

PER_MINUTE = 60.0


def lines(limits: WebLimits) -> tuple[Line, ...]:
    """Every number of the report with its meaning: the expected speed, its limit, film, angles."""
    rate, limiting, missing = limits.sampling_limit(1.0), limits.limiting, 180.0 - degrees(limits.coverage)
    window = "∞" if limits.window == inf else f"{limits.window:.2f} mm"
    flows = "does not flow" if limits.viscosity is None else f"{limits.viscosity / Pa_s:.4g} Pa·s at hand"
    return (
        Line("speed expected", speed(limits.speed), f"{limits.length:g} mm in {limits.length / limits.speed:,.0f} s"),
        Line("advance per angle", f"{1e3 * limits.advance:.1f} µm", f"{limits.tangential_sampling:.2f} angles per mm"),
        Line("angles", f"{limits.pose_rate:.1f} /s", f"{limits.poses:,.0f} over the length"),
        Line("frames", f"{limits.frame_rate:.1f} /s",
             f"{limits.frames:,.0f} over the length, {limits.lens.bins} an angle"),
        Line("slot", f"{1e3 * limits.slot:.1f} ms",
             f"light can be on {100 * limits.duty:.0f} % of it; the web moves {1e3 * limits.smear:.0f} µm"),
        Line("data", f"{limits.data_rate / 1e6:.1f} MB/s",
             f"{limits.nbytes / 1e9:.1f} GB over the length, {limits.display.bits} bits per pixel"),
        *(Line(f"most by {limit.name}", speed(limit.speed), limit.reason) for limit in limits.speeds),
        Line("greatest speed", speed(limiting.speed), f"limited by {limiting.name}: {limiting.reason}"),
        Line("sampling at 1 mm/s", "any" if rate == inf else f"{rate:.1f} /mm",
             "angles per mm for which the lens settles"),
        Line("window", window,
             f"least length of a straight run, where light falls to 5 %; set to {limits.roller.leg:.2f} mm"),
        Line("viscosity needed", f"{limits.viscosity_needed / Pa_s:,.4g} Pa·s",
             f"flow under {1e3 * limits.tolerable_flow:.2f} µm/s for {limits.lit_time:.0f} s in the light; {flows}"),
        Line("least speed", speed(limits.slowest), "slower, the resin flows off while it is lit"),
        Line("defocus", f"{limits.defocus:.2f} mm",
             f"at the worst column; {limits.bins_needed} bins keep it under {0.5 * limits.depth_of_focus:g} mm"),
        Line("angular coverage", f"{limits.coverage:.3f} rad", f"{180.0 - missing:.1f}° of directions in the film"),
        Line("spatial frequencies", f"{100 * limits.covered_share:.1f} %",
             f"of those along and into the film; a wedge of {missing:.1f}° about the normal is missing"),
    )  # fmt: skip


def speed(value: float) -> str:
    """A speed [mm/s] as text."""
    return "any" if value == inf else f"{PER_MINUTE * value:.4g} mm/min"
