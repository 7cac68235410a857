# SPDX-License-Identifier: Apache-2.0
"""Plane frames beside hand calculations and beside PyNite."""

import numpy as np
import pytest
from numpy.random import default_rng

from abrace_core import AbraceError
from abrace_studies.frames.frame import Frame, Member, Section

SECTION = Section(2.0e9, 4.0e7)
HEIGHT, WIDTH, MASS = 3.0, 5.0, 1000.0
YOUNG = 2.0e11


def held(count: int, *nodes: int) -> np.ndarray:
    supports = np.zeros((count, 3), dtype=bool)
    supports[list(nodes)] = True
    return supports


def cantilever(hinged: tuple[bool, bool] = (False, False)) -> Frame:
    nodes = np.array([[0.0, 0.0], [0.0, HEIGHT]])
    return Frame(nodes, (Member(0, 1, SECTION, hinged),), held(2, 0), np.zeros((2, 3)))


def portal(beam: Section, hinged: bool = False) -> Frame:
    nodes = np.array([[0.0, 0.0], [WIDTH, 0.0], [0.0, HEIGHT], [WIDTH, HEIGHT]])
    column = Section(1e14, SECTION.bending)
    members = (Member(0, 2, column), Member(1, 3, column), Member(2, 3, beam, (hinged, hinged)))
    masses = np.zeros((4, 3))
    masses[2:, 0] = MASS / 2
    return Frame(nodes, members, held(4, 0, 1), masses, ((2, 3),))


def test_the_moment_at_the_foot_of_a_cantilever_is_force_times_height():
    frame = cantilever()
    displaced = np.concatenate([np.zeros(3), np.linalg.solve(frame.stiffness(), [1.0, 0.0, 0.0])])
    foot, top = frame.end_moments() @ displaced
    assert abs(foot) == pytest.approx(HEIGHT)
    assert top == pytest.approx(0.0, abs=1e-9)


def test_a_portal_under_a_hinged_beam_sways_with_two_cantilevers():
    structure = portal(SECTION, hinged=True).structure()
    assert structure.stiffness[0, 0] == pytest.approx(2 * 3 * SECTION.bending / HEIGHT**3, rel=1e-9)
    assert structure.mass.tolist() == [[MASS]]
    assert structure.modes()[0] == pytest.approx(np.sqrt(structure.stiffness[0] / MASS))
    assert structure.ground_load.tolist() == pytest.approx([MASS])


def test_a_mechanism_is_refused_by_the_displacement_that_nothing_holds():
    with pytest.raises(AbraceError, match="rotation of node 1: nothing holds it, expected a stable frame"):
        cantilever((False, True)).stiffness()
    with pytest.raises(AbraceError, match="nothing holds it"):
        cantilever((True, False)).stiffness()


def test_what_does_not_fit_a_frame_is_refused():
    nodes, supports, masses = np.zeros((2, 2)), held(2, 0), np.zeros((2, 3))
    with pytest.raises(AbraceError, match="member 0 has no length"):
        Frame(nodes, (Member(0, 1, SECTION),), supports, masses)
    with pytest.raises(AbraceError, match="node 2, expected one from 0 to 1"):
        Frame(nodes, (Member(0, 2, SECTION),), supports, masses)
    with pytest.raises(AbraceError, match=r"masses of shape \(1, 3\), expected \(2, 3\)"):
        Frame(nodes, (), supports, masses[:1])


def random_frame(seed: int) -> Frame:
    """Crooked columns and beams of random sections on fixed feet, some beams hinged."""
    random = default_rng(seed)
    bays, storeys = 1 + seed % 2, 1 + seed % 3
    grid = np.array([(5.0 * i, 3.5 * j) for j in range(storeys + 1) for i in range(bays + 1)])
    nodes = grid + random.uniform(-0.4, 0.4, grid.shape)
    members = []
    for j in range(storeys):
        for i in range(bays + 1):
            foot = j * (bays + 1) + i
            members.append((foot, foot + bays + 1))
            if i < bays:
                members.append((foot + bays + 1, foot + bays + 2))
    made = tuple(
        Member(
            start,
            end,
            Section(YOUNG * random.uniform(0.005, 0.05), YOUNG * random.uniform(1e-4, 3e-3)),
            # a column turns with its nodes, so that none is free to turn
            ((False, False), (True, False), (False, True), (True, True))[random.integers(4) if end == start + 1 else 0],
        )
        for start, end in members
    )
    return Frame(nodes, made, held(len(nodes), *range(bays + 1)), np.zeros((len(nodes), 3)))


def displacements_by_pynite(frame: Frame, loads: np.ndarray) -> np.ndarray:
    model = pytest.importorskip("Pynite", reason="PyNiteFEA needs NumPy 2").FEModel3D()
    model.add_material("steel", YOUNG, YOUNG / 2.6, 0.3, 7850.0)
    for i, (x, y) in enumerate(frame.nodes):
        model.add_node(f"N{i}", x, y, 0.0)
        supports = frame.supports[i]
        model.def_support(f"N{i}", supports[0], supports[1], True, True, True, supports[2])
        for load, direction in zip(loads[i], ("FX", "FY", "MZ"), strict=True):
            model.add_node_load(f"N{i}", direction, load)
    for i, member in enumerate(frame.members):
        bending = member.section.bending / YOUNG
        model.add_section(f"S{i}", member.section.axial / YOUNG, bending, bending, 2 * bending)
        model.add_member(f"M{i}", f"N{member.start}", f"N{member.end}", "steel", f"S{i}")
        model.def_releases(f"M{i}", Rzi=member.hinged[0], Rzj=member.hinged[1])
    model.analyze_linear()
    nodes = (model.nodes[f"N{i}"] for i in range(len(frame.nodes)))
    return np.array([(node.DX["Combo 1"], node.DY["Combo 1"], node.RZ["Combo 1"]) for node in nodes])


@pytest.mark.parametrize("seed", range(8))
def test_random_frames_are_displaced_as_pynite_says(seed):
    frame = random_frame(seed)
    numbers, loads = frame.coordinates(), default_rng(100 + seed).normal(size=(len(frame.nodes), 3)) * 1e4
    found = np.zeros(loads.shape)
    found[numbers >= 0] = np.linalg.solve(frame.stiffness(), loads[numbers >= 0])
    expected = displacements_by_pynite(frame, loads)
    assert found == pytest.approx(expected, rel=0, abs=1e-9 * np.abs(expected).max())


def test_condensation_is_exact_for_what_has_no_mass():
    frame = random_frame(5)
    masses = np.zeros((len(frame.nodes), 3))
    masses[-6:, :2] = MASS
    structure = Frame(frame.nodes, frame.members, frame.supports, masses).structure()
    flexibility = np.linalg.inv(frame.stiffness())
    kept = frame.coordinates()[-6:, :2].ravel()
    assert np.linalg.inv(structure.stiffness) == pytest.approx(flexibility[np.ix_(kept, kept)], rel=1e-9)
