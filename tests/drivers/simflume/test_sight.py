from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, map_coordinates

from thermacq_drivers.simflume.correspondence import CYLINDER, WATER, correspondence
from thermacq_drivers.simflume.heat_settings import CylinderSettings
from thermacq_drivers.simflume.local_grid import LocalGrid
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.scene import WaterView, build_surface, build_view, check_scene
from thermacq_drivers.simflume.settings import SceneSettings, parse_scene
from thermacq_drivers.simflume.sight import CAPILLARY_LENGTH_M, Sight, build_sight
from thermacq_drivers.simflume.solids import check_cylinder, faces, wall_depth

TIME_S = 0.43
CYLINDER_SCENE = {"surface": {"kind": "regular", "case": "T0.791-H2/25"}, "cylinder": {}}
BEHIND = {"x_m": 0.84, "y_m": -0.06, "azimuth_deg": 180.0}

Pair = tuple[SceneSettings, Sight, Sight]


def make_pair(scene: dict[str, Any], **mounting: Any) -> Pair:
    settings = parse_scene(scene)
    surface = build_surface(settings)
    left, right = (
        build_sight(settings, surface, build_camera(Mounting.model_validate({"side": side, **mounting})))
        for side in ("left", "right")
    )
    return settings, left, right


@pytest.fixture(scope="module")
def upstream() -> Pair:
    return make_pair(CYLINDER_SCENE)


@pytest.fixture(scope="module")
def downstream() -> Pair:
    return make_pair(CYLINDER_SCENE, **BEHIND)


def whole_grid(camera: PinholeCamera) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(np.arange(camera.columns), np.arange(camera.rows)), -1).astype(np.float64)


def above_water(settings: SceneSettings, sight: Sight, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of points above the water with its meniscus."""
    cylinder = settings.cylinder
    assert cylinder is not None
    radius = np.hypot(points[..., 0] - cylinder.x_m, points[..., 1] - cylinder.y_m)
    beyond = np.maximum(radius - cylinder.radius_m, 0)
    water = sight.surface.elevation(points[..., 0], points[..., 1], TIME_S)
    return points[..., 2] - water - cylinder.meniscus_m * np.exp(-beyond / CAPILLARY_LENGTH_M)


def first_contact(
    settings: SceneSettings, sight: Sight, start: NDArray[np.float64], rays: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Depth at which rays (rays, 3) first touch cylinder or water, by short steps and then bisection."""
    cylinder = settings.cylinder
    assert cylinder is not None

    def free(depth: NDArray[np.float64]) -> NDArray[np.bool_]:
        points = start + depth[..., None] * rays
        radius = np.hypot(points[..., 0] - cylinder.x_m, points[..., 1] - cylinder.y_m)
        solid = (radius < cylinder.radius_m) & (points[..., 2] < cylinder.top_m)
        return (above_water(settings, sight, points) > 0) & ~solid

    depth = np.zeros(len(rays))
    step = 0.0005 / np.linalg.norm(rays, axis=1)
    going = np.ones(len(rays), bool)
    depth += 0.25
    while going.any():
        going &= free(depth)
        depth = np.where(going, depth + step, depth)
    low, high = depth - step, depth
    for _ in range(30):
        middle = (low + high) / 2
        clear = free(middle)
        low, high = np.where(clear, middle, low), np.where(clear, high, middle)
    return (low + high) / 2


@pytest.mark.parametrize("which", ["upstream", "downstream"])
def test_depth_and_class_agree_with_rays_marched_by_brute_force(
    which: str, request: pytest.FixtureRequest
) -> None:
    settings, sight, _ = request.getfixturevalue(which)
    depth, on_cylinder = sight.depth(TIME_S)
    assert 0.01 < on_cylinder.mean() < 0.2
    random = np.random.default_rng(3)
    # Half of the pixels anywhere, half at the edge of the cylinder, where it is hardest.
    edge = np.argwhere(binary_dilation(on_cylinder, iterations=4) & ~on_cylinder)
    anywhere = random.integers((0, 0), on_cylinder.shape, (150, 2))
    pixels = np.concatenate([anywhere, edge[random.integers(0, len(edge), 150)]])
    rows, columns = pixels.T
    rays = sight.camera.rays(pixels[:, ::-1].astype(np.float64))
    expected = first_contact(settings, sight, sight.camera.centre_m, rays)
    np.testing.assert_allclose(depth[rows, columns], expected, atol=2e-6)
    points = sight.camera.centre_m + expected[:, None] * rays
    cylinder = settings.cylinder
    radius = np.hypot(points[:, 0] - cylinder.x_m, points[:, 1] - cylinder.y_m)
    touches = (radius < cylinder.radius_m + 1e-6) & (above_water(settings, sight, points) > 1e-5)
    np.testing.assert_array_equal(on_cylinder[rows, columns], touches)


@pytest.mark.parametrize("case", ["T0.553-H2/25", "T0.791-H1/10"])
def test_every_pixel_of_water_lies_on_it_to_a_thousandth_of_a_pixel(case: str) -> None:
    settings, left, right = make_pair({**CYLINDER_SCENE, "surface": {"kind": "regular", "case": case}})
    depth, on_cylinder = left.depth(TIME_S)
    points = left.camera.centre_m + depth[..., None] * left.camera.rays(whole_grid(left.camera))
    moved = points.copy()
    moved[..., 2] -= above_water(settings, left, points)
    off = np.linalg.norm(right.camera.project(moved) - right.camera.project(points), axis=-1)
    assert off[~on_cylinder].max() < 0.001


@pytest.mark.parametrize("which", ["upstream", "downstream"])
def test_occlusion_agrees_with_brute_force(which: str, request: pytest.FixtureRequest) -> None:
    settings, left, right = request.getfixturevalue(which)
    for sight, other in ((left, right), (right, left)):
        found = correspondence(sight, other.camera, TIME_S)
        assert 300 < found.occluded.sum() < 20_000
        random = np.random.default_rng(5)
        near = np.argwhere(binary_dilation(found.occluded, iterations=6) & ~found.outside)
        rows, columns = near[random.integers(0, len(near), 200)].T
        rays = sight.camera.rays(np.stack([columns, rows], -1).astype(np.float64))
        points = sight.camera.centre_m + found.depth_m[rows, columns, None] * rays
        way = points - other.camera.centre_m
        reached = first_contact(settings, sight, other.camera.centre_m, way)
        # Points within a tenth of a millimetre of the shadow's edge may be counted either way.
        hidden = reached < 1 - 2e-4
        assert np.mean(hidden != found.occluded[rows, columns]) < 0.01


@pytest.mark.parametrize("which", ["upstream", "downstream"])
def test_left_and_right_agree(which: str, request: pytest.FixtureRequest) -> None:
    _, left, right = request.getfixturevalue(which)
    there, back = correspondence(left, right.camera, TIME_S), correspondence(right, left.camera, TIME_S)
    common = ~there.occluded & ~there.outside
    rows, columns = np.rint(there.row_px[common]).astype(int), np.rint(there.column_px[common]).astype(int)
    np.clip(rows, 0, 511, out=rows)
    np.clip(columns, 0, 639, out=columns)
    # What both see is of the same kind, but for the pixel at an edge; and leads back to where it came from.
    assert np.mean(there.seen[common] != back.seen[rows, columns]) < 0.003
    inside = np.all([rows > 2, rows < 509, columns > 2, columns < 637], axis=0)
    found = map_coordinates(
        back.column_px, [there.row_px[common][inside], there.column_px[common][inside]], order=1
    )
    wrong = np.abs(found - np.nonzero(common)[1][inside])
    assert np.quantile(wrong, 0.99) < 0.01
    # What the other does not see, nothing in its picture leads back to.
    assert set(np.unique(there.seen)) == {WATER, CYLINDER}


def test_true_disparity_warps_water_and_cylinder(upstream: Pair) -> None:
    settings, left, right = upstream
    seen = [WaterView(settings, sight.camera).temperature(TIME_S, 0) for sight in (left, right)]
    truth = correspondence(left, right.camera, TIME_S)
    warped = map_coordinates(seen[1].astype(np.float64), [truth.row_px, truth.column_px], order=5)
    common = ~truth.occluded & ~truth.outside
    right_edges = binary_dilation(right.depth(TIME_S)[1], iterations=4)
    touches = map_coordinates(right_edges.astype(np.float64), [truth.row_px, truth.column_px], order=1) > 0
    around = binary_dilation(truth.seen == CYLINDER, iterations=4)
    water = common & ~around & ~touches
    water[:6] = water[-6:] = water[:, :6] = water[:, -6:] = False
    inside = (truth.column_px > 5) & (truth.column_px < 634) & (truth.row_px > 5) & (truth.row_px < 506)
    residual = (seen[0] - warped)[water & inside]
    assert (water & inside).mean() > 0.75
    assert residual.std() < 0.003
    on_wall = common & inside & ~binary_dilation(truth.seen == WATER, iterations=4)
    strips = (seen[0] - warped)[on_wall]
    assert seen[0][on_wall].std() > 0.3
    # The edges of strips are averaged over different pixels in the two pictures, and none is moved.
    assert strips.std() < 0.2 * seen[0][on_wall].std()
    slope = np.gradient(seen[0].astype(np.float64), axis=1)[on_wall]
    assert abs(strips @ slope) / (slope @ slope) < 0.02


@pytest.mark.parametrize("radius_m", [0.02, 0.2])
@pytest.mark.parametrize("case", ["T0.791-H1/10", "T1.186-H1/16"])
def test_every_moment_of_every_wave_can_be_drawn(
    case: str, radius_m: float, small_mounting: Callable[..., Mounting]
) -> None:
    scene = {"surface": {"kind": "regular", "case": case}, "cylinder": {"radius_m": radius_m, "x_m": 0.5}}
    settings = parse_scene(scene)
    sight = build_sight(settings, build_surface(settings), build_camera(small_mounting()))
    for time_s in np.linspace(0, 1.2, 12):
        water = sight.water(float(time_s))
        x, y, z = np.moveaxis(water.points_m, -1, 0)
        outside = np.hypot(x - 0.5, y + 0.03) > 1.01 * radius_m
        gap = (z - sight.surface.elevation(x, y, float(time_s)))[outside]
        assert np.abs(gap).max() < 1e-8


def test_rays_meet_wall_and_top() -> None:
    cylinder = CylinderSettings(x_m=0.0, y_m=0.0, radius_m=0.1, top_m=0.3)
    centre = np.array([-1.0, 0.0, 0.5])
    rays = np.array(
        [[1.0, 0.0, -0.3], [1.0, 0.0, -0.2], [1.0, 0.0, -0.1], [1.0, 0.2, -0.3], [-1.0, 0.0, -0.3]]
    )
    depth = wall_depth(cylinder, centre, rays)
    np.testing.assert_allclose(depth[:2], [0.9, 1.0])  # the wall; the top, 20 cm below after 1 m
    assert np.all(np.isinf(depth[2:]))
    points = centre + depth[:2, None] * rays[:2]
    camera = build_camera(Mounting(x_m=-1.0, height_m=0.5))
    np.testing.assert_array_equal(faces(cylinder, points, camera), [True, True])
    assert not faces(cylinder, np.array([0.1, 0.0, 0.1]), camera)


def test_a_cylinder_out_of_sight_changes_nothing_but_the_water_around_it() -> None:
    scene = parse_scene({"cylinder": {"x_m": 3.0}})
    camera = build_camera(Mounting())
    sight = build_sight(scene, build_surface(scene), camera)
    assert sight.picture is None
    plain = WaterView(parse_scene({}), camera).temperature(0.2, 0)
    np.testing.assert_allclose(WaterView(scene, camera).temperature(0.2, 0), plain, atol=0.003)


def test_local_interpolation_is_of_fifth_degree() -> None:
    grid = LocalGrid(64, 80)

    def polynomial(place: NDArray[np.float64]) -> NDArray[np.float64]:
        column, row = (place[..., 0] - 30) / 40, (place[..., 1] - 20) / 40
        return 1 + row**5 - 2 * row**2 * column**3 + column**5

    column, row = np.meshgrid(np.arange(80.0), np.arange(64.0))
    expected = polynomial(np.stack([column, row], -1))
    at_nodes = polynomial(grid.nodes_px)
    np.testing.assert_allclose(grid.spread(at_nodes), expected, atol=1e-10)
    np.testing.assert_allclose(grid.spread_single(at_nodes), expected, atol=1e-4)
    part = grid.spread(at_nodes, slice(5, 20), slice(30, 75))
    np.testing.assert_allclose(part, expected[5:20, 30:75], atol=1e-10)


def test_rolling_read_out_sees_each_row_in_its_own_time() -> None:
    settings = parse_scene({**CYLINDER_SCENE, "texture": {"lifetime_s": 1e9}})
    camera = build_camera(Mounting())
    line_s = 20e-6
    rolled = WaterView(settings, camera, line_s).temperature(TIME_S, 0)
    still = WaterView(settings, camera)
    for row in (40, 300, 500):
        expected = still.temperature(TIME_S + row * line_s, 0)[row]
        np.testing.assert_allclose(rolled[row], expected, atol=0.02)
        assert np.abs(still.temperature(TIME_S, 0)[row] - expected).max() > (0.03 if row > 40 else 0)


def test_the_second_pair_looks_back(small_mounting: Callable[..., Mounting]) -> None:
    ahead, back = build_camera(small_mounting()), build_camera(small_mounting(azimuth_deg=180.0))
    assert ahead.rotation[2, 0] == pytest.approx(-back.rotation[2, 0])
    assert ahead.rotation[0, 1] == pytest.approx(-back.rotation[0, 1])
    np.testing.assert_allclose(back.rotation @ back.rotation.T, np.eye(3), atol=1e-12)
    right = build_camera(small_mounting(azimuth_deg=180.0, side="right"))
    assert right.centre_m[1] - back.centre_m[1] == pytest.approx(0.06, abs=0.001)


def test_the_pairs_together_see_all_around_the_cylinder(upstream: Pair, downstream: Pair) -> None:
    seen = np.zeros(360, bool)
    for settings, sight, _ in (upstream, downstream):
        cylinder = settings.cylinder
        angle = np.radians(np.arange(360))
        radius = cylinder.radius_m + 0.01
        x, y = cylinder.x_m + radius * np.cos(angle), cylinder.y_m + radius * np.sin(angle)
        points = np.stack([x, y, sight.surface.elevation(x, y, TIME_S)], -1)
        pixels = sight.camera.project(points)
        inside = np.all((pixels > 0) & (pixels < [639, 511]), axis=1)
        way = points - sight.camera.centre_m
        seen |= inside & (wall_depth(cylinder, sight.camera.centre_m, way) > 1)
    assert seen.mean() > 0.99


@pytest.mark.parametrize(
    ("cylinder", "message"),
    [
        ({"radius_m": 0.5}, "does not fit between the walls"),
        ({"radius_m": 0.3, "y_m": 0.3}, "does not fit between the walls"),
        ({"foil_emissivity": [0.3, 0.1]}, "foil_emissivity"),
        ({"strip_size_m": [0.0001, 0.1]}, "1 mm"),
    ],
)
def test_impossible_cylinders_are_refused(cylinder: dict[str, Any], message: str) -> None:
    from thermacq.errors import RigError

    with pytest.raises(RigError, match=message):
        parse_scene({"cylinder": cylinder})


def test_a_camera_inside_the_cylinder_is_refused() -> None:
    cylinder = CylinderSettings(x_m=0.0, y_m=0.0, radius_m=0.1, top_m=1.0)
    with pytest.raises(ValueError, match="inside the cylinder"):
        check_cylinder(cylinder, build_camera(Mounting()))
    scene = parse_scene({"cylinder": {"x_m": 0.0, "y_m": 0.0, "top_m": 1.0}})
    with pytest.raises(ValueError, match="inside the cylinder"):
        check_scene(scene, Mounting())


def test_equal_seeds_draw_equal_cylinders(small_mounting: Callable[..., Mounting]) -> None:
    pictures = [
        build_view(parse_scene({"cylinder": {}, "seed": seed}), small_mounting()).temperature(0.0, 0)
        for seed in (4, 4, 5)
    ]
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert np.abs(pictures[0] - pictures[2]).max() > 0.1
