"""The simulated flume: water, cameras, wave probe and trigger that behave like the laboratory's.

Layers, each knowing only those above it:

- `surfaces`, `regular_wave`, `cases`: the water (elevation, slope, drift, material label);
- `component_sea` with `dispersion`, `spectra`, `wave_group`: seas as sums of linear waves;
- `diffraction`, `cylinder_table`, `cylinder`: waves around a cylinder; `composed`: several waters in one;
- `water`, `water_settings`, `water_facts`: the water of a scene, in settings and in numbers;
- `optics`, `projection`: pinhole cameras, and their rays cut with the water;
- `texture`, `chessboard`, `board_settings`: what there is to see;
- `lens`, `sensor` with `noise`, `drift`, `bad_pixels`, `warm_up`, `shutter`: how a microbolometer sees it;
- `scene`: settings of the scene put together into something that a camera can look at; `bolometer`: seen with inertia;
- `camera`, `probe`, `trigger`, with `exposures`, `line`, `epoch`: devices behind `thermacq.devices`;
- `truth`, `truth_file`, `camera_truth`, `commands`: what the simulation knows, and the ``thermacq simulate`` commands.

Flume coordinates are the world frame: origin on the still water below the left camera, X along the wave
direction, Y across, Z up; metres and seconds.
"""
