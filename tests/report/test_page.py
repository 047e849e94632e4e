from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from thermacq.report import figures
from thermacq.report.data import ReportData
from thermacq.report.page import headlines, render

SECTIONS = (
    "agreement",
    "waves",
    "surface",
    "frames",
    "flat-water",
    "quantisation",
    "synchronisation",
    "losses",
    "provenance",
)
VOID = {"meta", "img", "br", "hr", "link", "input", "use", "path", "image", "stop", "rect"}
LOADING = ("src", "href", "srcset", "data", "action", "poster", "background")


class Page(HTMLParser):
    """Collects what matters of a page and checks that its elements are nested properly."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.ids: list[str] = []
        self.sources: list[str] = []
        self.tags: list[str] = []
        self.handlers: list[str] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value)
            if name.split(":")[-1] in LOADING:
                self.sources.append(value)
            if name.startswith("on"):
                self.handlers.append(name)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def full_page(full_data) -> str:
    return render(full_data)


@pytest.fixture(scope="module")
def parsed(full_page) -> Page:
    return Page(full_page)


def test_every_section_and_figure_is_there(parsed):
    assert set(SECTIONS) <= set(parsed.ids)
    assert parsed.tags.count("svg") == 7
    assert parsed.tags.count("img") == 3
    assert "Simulated." in parsed.text


def test_nothing_is_loaded_from_anywhere(parsed, full_page):
    assert parsed.sources
    assert all(source.startswith(("#", "data:image/png;base64,")) for source in parsed.sources)
    assert not {"script", "link", "iframe", "object", "embed", "base", "form"} & set(parsed.tags)
    assert "@import" not in full_page
    assert all(target.startswith(("#", "&quot;#")) for target in re.findall(r"url\(([^)]*)\)", full_page))
    assert "default-src 'none'" in full_page


def test_ids_are_unique_and_references_resolve(parsed, full_page):
    assert len(parsed.ids) == len(set(parsed.ids))
    referenced = {source[1:] for source in parsed.sources if source.startswith("#")}
    referenced |= set(re.findall(r"url\(#([^)]*)\)", full_page))
    assert referenced <= set(parsed.ids)


def test_text_from_files_is_shown_and_never_markup(parsed, full_page):
    assert parsed.handlers == []
    assert "<script" not in full_page
    shown = " ".join(parsed.text)
    assert shown.count('<script>alert("x")</script> $\\frac{a}$ & \'"{{ 7*7 }}') >= 6
    assert "49" not in re.findall(r"& '\"(.{9})", shown)


def test_the_page_is_small_enough(full_page):
    assert len(full_page.encode()) < 2_000_000


def test_numbers_at_the_top(full_data):
    found = {item.name: item for item in headlines(full_data)}
    comparison = full_data.comparisons[0]
    assert found["slope"].value == f"{comparison.agreement.slope:.4f}"
    assert found["mean wave height"].value == f"{100 * comparison.measured_waves.mean_height_m:.2f} cm"
    assert found["mean wave height"].beside.startswith("probe 7.8")
    assert found["still-water σ"].value == f"{1000 * full_data.flatness.overall_sd_m:.2f} mm"
    # In virtual time nothing was late because nothing could be: a figure would look like a merit.
    assert found["skew p99"].value == "virtual clock"
    real = replace(full_data, sync={**full_data.sync, "clock": "real"})
    assert {item.name: item.value for item in headlines(real)}["skew p99"] == "0.24 µs"


@pytest.mark.parametrize(
    "missing",
    [
        {"comparisons": (), "flatness": None, "events": (), "event_count": 0},
        {"sample": None, "quantisation": None, "provenance": {}, "notes": ()},
        {"surface": None, "coverage": None, "sync": None, "events": ()},
    ],
    ids=["comparisons", "sample", "surface"],
)
def test_a_missing_part_leaves_the_rest_whole(full_data, missing):
    page = Page(render(replace(full_data, **missing)))
    assert set(SECTIONS) <= set(page.ids)


def test_an_almost_empty_report():
    page = Page(render(ReportData("nothing", "2026-01-01")))
    assert set(SECTIONS) <= set(page.ids)
    assert "Simulated." not in page.text
    assert "svg" not in page.tags


def test_one_missing_camera_picture(full_data):
    page = Page(render(replace(full_data, sample=replace(full_data.sample, right=None, disparity=None))))
    assert page.tags.count("img") == 2


def test_surfaces_with_hardly_any_support(full_data):
    eta = np.full_like(full_data.surface.eta_m, np.nan)
    eta[3, 3] = 0.01
    page = Page(render(replace(full_data, surface=replace(full_data.surface, eta_m=eta))))
    assert page.tags.count("img") == 3


def test_figures_repeat_exactly(full_data):
    assert figures.scatter(full_data.comparisons[0]) == figures.scatter(full_data.comparisons[0])


def test_role_never_hands_on_a_name():
    assert figures.role("truth (simulated) at probe $x$") == "truth"
    assert figures.role("probe $\\frac{$") == "probe"
    assert figures.role("<b>") == "series"


def test_holes_in_a_surface_warn_of_nothing_whatever_unset_memory_holds(full_data, monkeypatch):
    empty = np.empty

    def unlucky(*arguments, **options):
        made = empty(*arguments, **options)
        if made.dtype == float:
            made.fill(1e308)
        return made

    eta_m = full_data.surface.eta_m.copy()
    eta_m[::7, ::5] = np.nan
    monkeypatch.setattr(np, "empty", unlucky)
    # Warnings are errors here.
    assert figures.surface_3d(replace(full_data.surface, eta_m=eta_m)).startswith("data:image/png")
