"""What `mutations.py` breaks: small physical errors, each with the tests that must notice it.

Every test that a row of docs/papers.md cites stands in at least one mutation of that row; `test_mutations.py` sees to
it, and that the code still has exactly one place for each error.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutation:
    """One error in one file.

    Args:
        row: of docs/papers.md, or a word for what no row covers.
        error: what is wrong afterwards, in words.
        file: from the root of the repository.
        old: text that occurs exactly once in the file.
        new: what replaces it.
        tests: paths from the root, each with or without ``::test``; every one of them must fail.
    """

    row: str
    error: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


MUTATIONS: tuple[Mutation, ...] = (
    # ---- roll-to-roll ----------------------------------------------------------------------------------------------
    Mutation(
        "R1", "lengths along the roller's face, not the neutral line", "vamgpu/optics/wrap_map.py",
        "along = self.neutral * np.arctan2(", "along = self.inner * np.arctan2(",
        ("tests/optics/test_roller.py",),
    ),
    Mutation(
        "R1", "Jacobian over the inner radius", "vamgpu/optics/wrap_map.py",
        "(self.inner + depth) / self.neutral, 1.0)", "(self.inner + depth) / self.inner, 1.0)",
        ("tests/optics/test_roller.py",),
    ),
    Mutation(
        "R1", "voxels of the flat film of lengths along the roller's face", "vamgpu/optics/roller_cells.py",
        "phi = (l - map.middle) / map.neutral - self.turn[:, None]",
        "phi = (l - map.middle) / map.inner - self.turn[:, None]",
        ("tests/physics/test_web_energy.py",),
    ),
    Mutation(
        "R2", "Fresnel's compensation not clipped", "vamgpu/optics/roller.py",
        "np.maximum(self.transmittance(u), 1.0 / most)", "np.maximum(self.transmittance(u), 0.1 / most)",
        ("tests/optics/test_roller.py",),
    ),
    Mutation(
        "R2", "α_V without its α", "vamgpu/optics/wrap_map.py",
        "return absorption * np.exp(-absorption * self.path(x, y))", "return np.exp(-absorption * self.path(x, y))",
        ("tests/optics/test_roller.py",),
    ),
    Mutation(
        "R2", "gradient of n² half as steep", "kernels/eikonal.py",
        "slope = (d_above - square * d_below) / below", "slope = 0.5 * (d_above - square * d_below) / below",
        ("tests/optics/test_march.py",),
    ),
    Mutation(
        "R3", "shares between two columns swapped", "vamgpu/operators/web.py",
        "weight = np.concatenate([1.0 - share, share[share > 0]])",
        "weight = np.concatenate([share, 1.0 - share[share > 0]])",
        ("tests/contracts/test_web.py",),
    ),
    Mutation(
        "R3", "the fold one column late", "vamgpu/operators/bands.py",
        "pose, phase = np.divmod(light.l.astype(np.int64) + start, step)",
        "pose, phase = np.divmod(light.l.astype(np.int64) + start + 1, step)",
        ("tests/contracts/test_web.py",),
    ),
    Mutation(
        "R4", "no momentum in the paper's choices", "vamgpu/optimize/bclp.py",
        "return cls(p=3.0, ridge=0.04, momentum=0.5)", "return cls(p=3.0, ridge=0.04)",
        ("tests/optimize/test_bclp.py",),
    ),
    Mutation(
        "R4", "no tolerance band", "kernels/loss.py",
        "excess = np.abs(difference) - (slack_low + (slack_high - slack_low) * f)", "excess = np.abs(difference)",
        ("tests/optimize/test_bclp.py",),
    ),
    Mutation(
        "R4", "the step of a web uphill", "vamgpu/webs/solver.py",
        "work.step(gradient, plain, self.step, self.method.momentum)",
        "work.step(gradient, plain, -self.step, self.method.momentum)",
        ("tests/webs/test_stream.py",),
    ),
    Mutation(
        "R5", "tiles are never forgotten", "vamgpu/webs/tiles.py",
        "self._advance(start)", "self._advance(0)",
        ("tests/webs/test_memory.py",),
    ),
    Mutation(
        "R5", "a resumed web finds its own scale", "vamgpu/webs/stream.py",
        "self.segments(len(folder.segments), known, before)", "self.segments(len(folder.segments), None, before)",
        ("tests/webs/test_resume.py",),
    ),
    Mutation(
        "R5", "the last frames of a web are missing", "vamgpu/webs/layout.py",
        "return self.lead + ceil(columns / self.step)", "return ceil(columns / self.step)",
        ("tests/webs/test_stream.py",),
    ),
    Mutation(
        "R6", "the film's middle behind the roller", "vamgpu/printing/focus.py",
        "return -np.sqrt(np.maximum(midline**2 - across**2, 0.0)) + 0.0",
        "return np.sqrt(np.maximum(midline**2 - across**2, 0.0)) + 0.0",
        ("tests/printing/test_focus.py",),
    ),
    Mutation(
        "R7", "slope of focus without the second relay's M²", "vamgpu/optics/lens.py",
        "return -self.index * (f2 * f4 / f3) ** 2 * DIOPTER", "return -self.index * f2**2 * DIOPTER",
        ("tests/optics/test_lens.py",),
    ),
    Mutation(
        "R8", "the line of focus meets the stage on the wrong side", "vamgpu/calibration/focus.py",
        "return FocusLine(slope, center - slope * middle,", "return FocusLine(slope, center + slope * middle,",
        ("tests/calibration/test_focus.py", "tests/hosts/test_calibrating.py::test_focus_finds_the_line_of_the_optics"),
    ),
    Mutation(
        "R9", "the axis on the first edge", "vamgpu/calibration/axis.py",
        "return RollerAxis(0.5 * (first.column + last.column),", "return RollerAxis(first.column,",
        ("tests/calibration/test_axis.py",),
    ),
    Mutation(
        "R9", "the scan lights the next column", "hosts/calibrating/axis.py",
        "patterns.line(screen.shape, int(column))", "patterns.line(screen.shape, int(column) + 1)",
        ("tests/hosts/test_calibrating.py::test_axis_finds_both_edges_of_the_roller",),
    ),
    Mutation(
        "R10", "a term of the gyroid with the wrong axis", "vamgpu/targets/lattices/tpms.py",
        "value = sr * cl + sl * cz + sz * cr", "value = sr * cl + sl * cz + sz * cl",
        ("tests/targets/test_lattices.py",),
    ),
    Mutation(
        "R10", "a spiral that does not rise", "vamgpu/targets/spiral.py",
        "r = self.inner + self.rise * psi + depth", "r = self.inner + depth",
        ("tests/targets/test_spiral.py",),
    ),
    Mutation(
        "R11", "beams √2 too wide", "vamgpu/metrics/pointspread.py",
        "np.exp(-4.0 * log(2.0)", "np.exp(-2.0 * log(2.0)",
        ("tests/metrics/test_pointspread.py",),
    ),
    Mutation(
        "R11", "the wedge about the wrong axis", "vamgpu/metrics/pointspread.py",
        "angle = np.arctan2(np.abs(k_rho)[None, :], np.abs(k_l)[:, None])",
        "angle = np.arctan2(np.abs(k_l)[:, None], np.abs(k_rho)[None, :])",
        ("tests/metrics/test_pointspread.py",),
    ),
    Mutation(
        "R11", "ξ over what is outside, not everywhere", "vamgpu/metrics/contrast.py",
        "float(made.sum()))", "float(made[part <= 0].sum()))",
        ("tests/metrics/test_limited_dose.py",),
    ),
    Mutation(
        "R12", "viscosity without the 2 of a film's surface", "vamgpu/webs/limits.py",
        "return self.density * GRAVITY * self.roller.film.thickness**2 / (2.0 * self.tolerable_flow)",
        "return self.density * GRAVITY * self.roller.film.thickness**2 / self.tolerable_flow",
        ("tests/webs/test_limits.py",),
    ),
    Mutation(
        "R13", "the period rounded to the clock: pictures drift", "vamgpu/webs/timetable.py",
        "(first + np.arange(count))[:, None] * period", "(first + np.arange(count))[:, None] * round(period / tick) * tick",
        ("tests/webs/test_timetable.py",),
    ),
    Mutation(
        "R13", "the period in whole nanoseconds: beats drift", "hosts/schedules/timing.py",
        "return self.start + beats * whole + beats * rest // bottom", "return self.start + beats * whole",
        ("tests/hosts/test_schedule.py",),
    ),
    Mutation(
        "R13", "light a tenth too short", "hosts/schedules/rows.py",
        "int(table.on[slot]) // MICRO", "int(table.on[slot] * 0.9) // MICRO",
        ("tests/hosts/test_triggered.py",),
    ),
    Mutation(
        "R14", "a Gaussian of σ/√2", "vamgpu/metrics/gaussian.py",
        "np.exp(-0.5 * ((x - mean) / sigma) ** 2)", "np.exp(-(((x - mean) / sigma) ** 2))",
        ("tests/metrics/test_surface_distance.py",),
    ),
    # ---- photoinhibition -------------------------------------------------------------------------------------------
    Mutation(
        "P1", "what is spread is not made up for extinction", "vamgpu/optimize/dual/exact.py",
        "* np.exp(extinction * path)", "* np.exp(0.0 * path)",
        ("tests/optimize/test_exact.py",),
    ),
    Mutation(
        "P1", "subtracted light with the extinction of the other color", "vamgpu/optimize/dual/exact.py",
        "extinction = np.where(light < 0, at.negative, at.extinction) / at.radius",
        "extinction = at.extinction / at.radius",
        ("tests/optimize/test_exact.py",),
    ),
    Mutation(
        "P2", "as many angles as points, not twice as many", "vamgpu/optimize/dual/exact.py",
        "angles = 2 * across**2 + 1", "angles = across**2 + 1",
        ("tests/optimize/test_exact.py",),
    ),
    Mutation(
        "P3", "UV makes one radical, not two", "kernels/kinetics.py",
        "-terms.b * rest + 2.0 * (made - paired)", "-terms.b * rest + made - 2.0 * paired",
        ("tests/chemistry/test_kinetics.py",),
    ),
    Mutation(
        "P3", "the stationary state of one radical a split", "vamgpu/chemistry/stationary.py",
        "surplus = 2.0 * made(rates, uv, supply) - b", "surplus = made(rates, uv, supply) - b",
        ("tests/chemistry/test_stationary.py",),
    ),
    Mutation(
        "P3", "W of one radical a split", "vamgpu/chemistry/efficiency.py",
        'gain = 2.0 * positive("beta", beta, zero=True)', 'gain = positive("beta", beta, zero=True)',
        ("tests/chemistry/test_efficiency.py",),
    ),
    Mutation(
        "P4", "UV adds dose", "vamgpu/optimize/dual/passes.py",
        "            combine(1.0, dose, -colors.strength, undone, dose)\n            factor",
        "            combine(1.0, dose, colors.strength, undone, dose)\n            factor",
        ("tests/optimize/test_dual.py",),
    ),
    Mutation(
        "P4", "SC2 corrects by undersupply alone", "vamgpu/optimize/dual/passes.py",
        "combine(1.0, under, -1.0, over, under)", "combine(1.0, under, 0.0, over, under)",
        ("tests/optimize/test_dual.py",),
    ),
    Mutation(
        "P5", "the part may cure in the turn before the last", "vamgpu/chemistry/printability.py",
        "early = thresholds.optical / ((n - 1) * doses.in_most)", "early = thresholds.optical / (n * doses.in_most)",
        ("tests/chemistry/test_printability.py",),
    ),
    Mutation(
        "P6", "diffusion half as fast", "kernels/transport.py",
        "[...] += spread[axis] * gain", "[...] += 0.5 * spread[axis] * gain",
        ("tests/chemistry/test_transport.py",),
    ),
    Mutation(
        "P6", "UV makes one radical, not two", "kernels/transport.py",
        "_settled(b + 2.0 * (split - paired))", "_settled(b + split - 2.0 * paired)",
        ("tests/chemistry/test_reaction.py",),
    ),
    Mutation(
        "P6", "every frame a pose late", "vamgpu/chemistry/printrun.py",
        "self.exposure.irradiance(state.c, frame)", "self.exposure.irradiance(state.c, frame + 1)",
        ("tests/chemistry/test_printrun.py",),
    ),
    Mutation(
        "P7", "molar volume to the power −0.5", "vamgpu/chemistry/diffusivity.py",
        "* volume**-0.6", "* volume**-0.5",
        ("tests/chemistry/test_materials.py",),
    ),
    Mutation(
        "P7", "diffusion length along one axis", "vamgpu/chemistry/diffusivity.py",
        "return sqrt(6.0 * positive(", "return sqrt(2.0 * positive(",
        ("tests/chemistry/test_materials.py",),
    ),
    Mutation(
        "P8", "struts counted three times where they meet", "vamgpu/targets/designs.py",
        "- 2.0 * a * b * c", "- a * b * c",
        ("tests/targets/test_designs.py",),
    ),
    Mutation(
        "P8", "groups of a resolution target by fifths", "vamgpu/targets/designs.py",
        "(element - 1) / 6.0)\n            w", "(element - 1) / 5.0)\n            w",
        ("tests/targets/test_designs.py",),
    ),
    # ---- automatic exposure ----------------------------------------------------------------------------------------
    Mutation(
        "A1", "background where the part is wanted", "vamgpu/optimize/recipe.py",
        'levels = {"low": self.background, "high": 1.0, "reach": work.reach}',
        'levels = {"low": 1.0, "high": self.background, "reach": work.reach}',
        ("tests/optimize/test_recipe.py",),
    ),
    Mutation(
        "A1", "a background of 20 %, not 60 %", "vamgpu/optimize/recipe.py",
        "background: float = 0.6", "background: float = 0.2",
        ("tests/optimize/test_recipe.py",),
    ),
    Mutation(
        "A1", "the target corrected the wrong way", "kernels/update.py",
        "model *= np.minimum(most, wanted / np.maximum(np.maximum(dose * scale, floor), 1e-30))",
        "model /= np.minimum(most, wanted / np.maximum(np.maximum(dose * scale, floor), 1e-30))",
        ("tests/optimize/test_recipe.py",),
    ),
    Mutation(
        "A1", "columns not made up for their spacing in the resin", "vamgpu/optimize/rebin.py",
        "spacing / np.maximum(chords.transmittance, WEAKEST)", "1.0 / np.maximum(chords.transmittance, WEAKEST)",
        ("tests/optimize/test_rebin.py",),
    ),
    Mutation(
        "A1", "oxygen spreads half as far", "vamgpu/chemistry/diffusion.py",
        "spread = 2.0 * self.diffusivity * self.seconds * 0.5", "spread = self.diffusivity * self.seconds * 0.5",
        ("tests/chemistry/test_precompensate.py",),
    ),
    Mutation(
        "A2", "the background counts", "vamgpu/printing/scatter.py",
        "density = (total - self._background) / self.voxels", "density = total / self.voxels",
        ("tests/printing/test_scatter.py",),
    ),
    Mutation(
        "A2", "seconds counted from the camera, not the light", "hosts/exposure.py",
        "seconds = (now - self._origin) / SECOND", "seconds = now / SECOND",
        ("tests/hosts/test_exposure.py",),
    ),
    Mutation(
        "A3", "half disks count that hang on nothing", "vamgpu/metrics/merit.py",
        "whole = labels == np.bincount(found).argmax()", "whole = labels > 0",
        ("tests/targets/test_designs.py",),
    ),
    Mutation(
        "A3", "gaps a pixel too narrow", "vamgpu/targets/shapes/calibration.py",
        "parts.append(_half_disk(rim + gap * pixel, half_disk_radius)",
        "parts.append(_half_disk(rim + (gap - 1) * pixel, half_disk_radius)",
        ("tests/targets/test_shapes.py",),
    ),
    Mutation(
        "A4", "a print takes oxygen out of full resin", "vamgpu/chemistry/history.py",
        "oxygen, depth = self.oxygen * (1.0 - spent),", "oxygen, depth = self.oxygen - spent,",
        ("tests/chemistry/test_history.py",),
    ),
    Mutation(
        "A4", "oxygen from both faces", "vamgpu/chemistry/history.py",
        "odd = [(k + 0.5) * pi for k in range(64)]", "odd = [(2 * k + 1) * pi for k in range(64)]",
        ("tests/chemistry/test_history.py",),
    ),
    Mutation(
        "A5", "one direction alone counts", "vamgpu/metrics/surface_distance.py",
        "return np.sqrt(0.5 * (square + square.T))", "return np.sqrt(square)",
        ("tests/metrics/test_surface_distance.py",),
    ),
    Mutation(
        "A6", "an image a slot early at the end of a turn", "hosts/schedules/video.py",
        "end = beats.times(0, count, repeats), beats.times(repeats, count, repeats)",
        "end = beats.times(0, count, repeats), beats.times(repeats - 1, count, repeats)",
        ("tests/hosts/test_schedule.py",),
    ),
    Mutation(
        "A6", "the stage taken to be where it was a refresh ago", "hosts/players/turning.py",
        "(here - self.speed * age / SECOND) / self._unit", "(here - self.speed * self._frame / SECOND) / self._unit",
        ("tests/hosts/test_spinning.py",),
    ),
    Mutation(
        "A7", "a thread of 18 turns an inch", "vamgpu/targets/shapes/fasteners.py",
        "PITCH = INCH / 20.0", "PITCH = INCH / 18.0",
        ("tests/targets/test_shapes.py",),
    ),
    # ---- cure-through ----------------------------------------------------------------------------------------------
    Mutation(
        "C1", "what light adds not weakened by what is cured", "vamgpu/curethrough/dose.py",
        "out[n] = out[n + 1] + (added[n] - machine.decay * out[n + 1])", "out[n] = out[n + 1] + added[n]",
        ("tests/curethrough/test_dose.py",),
    ),
    Mutation(
        "C2", "full light builds up from nothing", "vamgpu/curethrough/constraints.py",
        "return constant_light(zeta, lower, critical, phi_max, eta)", "return constant_light(zeta, lower, 0.0, phi_max, eta)",
        ("tests/curethrough/test_correction.py",),
    ),
    Mutation(
        "C3", "level 0 is dark", "vamgpu/curethrough/printer.py",
        "measured_levels(floor + (top - floor) * numbers / (LEVELS - 1))",
        "measured_levels(top * numbers / (LEVELS - 1))",
        ("tests/curethrough/test_dose.py",),
    ),
    Mutation(
        "C4", "the far edge of a layer gets the dose of the near one", "vamgpu/curethrough/layers.py",
        "return Targets(np.array([[1.0 / (1.0 - self.decay)]]), np.array([NEVER]))",
        "return Targets(np.array([[1.0]]), np.array([NEVER]))",
        ("tests/curethrough/test_layers.py",),
    ),
    Mutation(
        "C5", "gel dose without ln 10", "vamgpu/curethrough/resin.py",
        "gel, factor = LN10 / slope *", "gel, factor = 1.0 / slope *",
        ("tests/curethrough/test_resin.py",),
    ),
    Mutation(
        "C6", "slices of a block upside down", "vamgpu/curethrough/stack.py",
        "self._pool.submit(self._decode, self.names[start + k], out[k])",
        "self._pool.submit(self._decode, self.names[stop - 1 - k], out[k])",
        ("tests/curethrough/test_stack.py",),
    ),
    Mutation(
        "C6", "the tail not counted among the layers", "vamgpu/curethrough/output.py",
        'layers = f"numFast = {slices}".encode()', 'layers = f"numFast = {slices - 1}".encode()',
        ("tests/curethrough/test_files.py",),
    ),
    Mutation(
        "C6", "the next level above a light, not the nearest", "vamgpu/printing/gray.py",
        "np.searchsorted(0.5 * (curve[1:] + curve[:-1]),", "np.searchsorted(curve[:-1],",
        ("tests/printing/test_gray.py",),
    ),
    # ---- what no row of the papers covers --------------------------------------------------------------------------
    Mutation(
        "margin", "the gather of bent light looks too near", "vamgpu/operators/light.py",
        "SAFETY = 1.5", "SAFETY = 0.2",
        ("tests/contracts/test_lit_edges.py::test_no_voxel_is_missed_where_columns_are_as_wide_as_voxels",),
    ),
    Mutation(
        "rim", "the map of the light breaks off at the rim", "vamgpu/operators/light.py",
        "    if not beyond.any():", "    if beyond.any():",
        ("tests/contracts/test_lit_edges.py::test_voxels_at_the_rim_are_lit_by_the_column_that_meets_them",),
    ),
    Mutation(
        "extremes", "numbers beyond float32 become infinite", "vamgpu/backend/device.py",
        "        if most > largest:", "        if most < 0.0:",
        ("tests/test_extremes.py::test_numbers_beyond_float32_are_refused_everywhere",),
    ),
    Mutation(
        "extremes", "light for a part in the dark", "vamgpu/optimize/reach.py",
        "    if share < LOST:", "    if share < 0.0:",
        ("tests/test_extremes.py::test_light_that_is_absorbed_before_the_part_is_told",),
    ),
    Mutation(
        "extremes", "light beside the cylinder counts", "vamgpu/printing/dark.py",
        "reach=parts.reach or 0.0", "reach=1e9",
        ("tests/test_extremes.py::test_frames_that_print_nothing_are_not_judged",),
    ),
    Mutation(
        "extremes", "the worse of rounding and error diffusion", "vamgpu/printing/pack.py",
        "    if misses[0] <= misses[1]:", "    if misses[0] > misses[1]:",
        ("tests/test_extremes.py::test_diffused_bits_are_never_worse_than_rounded_ones",),
    ),
)
