"""`clikgen analyse`: figures with their data, JSON, one report page; bad input in one line."""

import csv
import json
from html.parser import HTMLParser

import pytest

from clikgen.symbolic.spec import shipped_specs

SPEC = next(path for path in shipped_specs() if path.stem == "planar5")


@pytest.fixture
def in_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def names(folder, ending):
    return {path.stem for path in folder.glob(f"*.{ending}")}


def test_filter_is_designed_in_hertz_and_agrees_with_the_compiled_step(run_clikgen, tmp_path):
    outcome = run_clikgen("analyse", "filter", "--design", "5", "--out", tmp_path, "--json")
    assert outcome.returncode == 0
    found = json.loads(outcome.stdout)
    assert found["cutoff_hz"] == pytest.approx(3.5834, abs=1e-4)
    assert found["measured_gain_error"] < 0.01
    assert found["measured_phase_error_deg"] < 1
    again = json.loads(run_clikgen("analyse", "filter", "--cutoff", found["design"]["f_c"], "--json").stdout)
    assert again["cutoff_hz"] == pytest.approx(5.0, rel=1e-9)
    for ending in ("png", "svg", "csv"):
        assert names(tmp_path, ending) == {"filter_bode", "filter_cutoff", "filter_in_time"}
    with (tmp_path / "filter_bode.csv").open() as file:
        rows = list(csv.DictReader(file))
    nearest = min(rows, key=lambda row: abs(float(row["frequency [Hz]"] or "inf") - found["cutoff_hz"]))
    assert float(nearest["gain"]) == pytest.approx(2**-0.5, abs=5e-3)  # within a grid step of -3 dB


def test_clik_says_how_far_the_gain_may_go_and_measures_it(run_clikgen, tmp_path):
    outcome = run_clikgen("analyse", "clik", "paper", "--out", tmp_path, "--json")
    found = json.loads(outcome.stdout)
    assert found["loops"]["no filter"]["gain_bound"] == pytest.approx(200)
    for points in found["measured_boundary"].values():
        assert all(point["gain"] == pytest.approx(point["linear"], rel=0.01) for point in points)
    certified = found["certificates"]["no filter, within the limits"]
    assert certified["bounds"]["sigma_exact"]
    assert certified["bounds"]["hessian_exact"]
    assert 0 < certified["e_minus"] < 1e-3 < certified["e_plus"]
    assert {"clik_gain_bound", "clik_root_locus", "clik_response", "clik_stability_map"} <= names(tmp_path, "csv")


def test_unequal_cutoffs_are_taken_at_the_least_as_the_paper_does(run_clikgen):
    least = json.loads(run_clikgen("analyse", "clik", "paper", "--json").stdout)
    mixed = json.loads(
        run_clikgen("analyse", "clik", "paper", "--set", "filter_cutoff=[4, 4, 9, 5, 4]", "--json").stdout
    )
    assert mixed == least  # 4 Hz is the least


def test_delay_and_servo_lower_the_bound(run_clikgen):
    plain = json.loads(run_clikgen("analyse", "clik", "paper", "--json").stdout)
    slow = json.loads(run_clikgen("analyse", "clik", "paper", "--delay", 2, "--servo", 0.02, "--json").stdout)
    for reading in ("no filter", "A", "B", "C"):
        assert slow["loops"][reading]["gain_bound"] < plain["loops"][reading]["gain_bound"]


def test_chatter_of_the_paper_is_predicted(run_clikgen, tmp_path):
    found = json.loads(run_clikgen("analyse", "chatter", "paper", "--out", tmp_path, "--json").stdout)
    regimes = {case: [each["regime"] for each in one["encounters"]] for case, one in found["cases"].items()}
    assert regimes == {"1": ["Nyquist two-cycle"] * 2, "2": ["sawtooth"] * 2, "3": ["sawtooth"] * 2}
    for case in ("2", "3"):
        for stretch in found["cases"][case]["stretches"]:
            assert stretch["predicted"]["regime"] == stretch["measured"]["regime"]
    for of_case in found["map"].values():
        assert of_case["below_2"] < 0.4 < 0.99 < of_case["2_to_4"]
    assert names(tmp_path, "svg") == {"chatter_regimes", "chatter_agreement", "chatter_examples", "chatter_map"}


class Page(HTMLParser):
    """What a page refers to, its headings, and how many pictures it holds."""

    def __init__(self) -> None:
        super().__init__()
        self.links, self.anchors, self.pictures, self.open = [], set(), 0, []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.anchors.add(attributes.get("id"))
        self.links += [attributes[name] for name in ("src", "href") if name in attributes]
        self.pictures += tag == "img"
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_report_is_one_page_that_needs_nothing_else(run_clikgen, tmp_path):
    outcome = run_clikgen("analyse", "report", "paper", "--out", tmp_path)
    assert outcome.returncode == 0
    text = (tmp_path / "report.html").read_text()
    page = Page()
    page.feed(text)
    assert page.open == []  # every element is closed
    assert all(link.startswith("data:image/png;base64,") or link[1:] in page.anchors for link in page.links)
    assert page.pictures == len(names(tmp_path, "svg")) == len(names(tmp_path, "csv")) >= 15
    manifest = json.loads((SPEC.parent.parent.parent / "generated" / "planar5" / "manifest.json").read_text())
    assert manifest["spec_sha256"] in text
    assert all(digest in text for digest in manifest["source_sha256"].values())
    for words in ("Simulation", "Filter of planar5", "CLIK loop", "Chatter", "Assumptions", "viewport"):
        assert words in text
    document = json.loads((tmp_path / "report.json").read_text())
    assert len(document) == 4


def arm(folder, run_clikgen):
    """A fixed planar 2R arm, generated into ./generated, and a scenario that stretches it out."""
    text = SPEC.read_text()
    joints = text[text.index('[[robot.joints]]\nname = "shoulder"') : text.index("[[robot.frames]]")]
    head = text[: text.index("[[robot.joints]]")].replace('name = "planar5"', 'name = "arm2"')
    frames = text[text.index("[[robot.frames]]") : text.index("[[robot.points_of_interest]]")]
    tail = text[text.index('[[tasks]]\nname = "tool"') :]
    (folder / "arm2.toml").write_text(head + joints + frames + tail)
    assert run_clikgen("generate", "arm2.toml").returncode == 0
    (folder / "stretch.toml").write_text(
        'name = "stretch"\ndescription = "to the edge"\ncontroller = "arm2"\nduration = 4.0\nq0 = [0.3, -0.6]\n'
        '[references.tool]\nkind = "point_to_point"\nstart = [1.06, 0.03]\nend = [1.2, 0.0]\nduration = 3.0\n'
    )


def test_singular_jacobian_is_one_line(run_clikgen, in_folder):
    arm(in_folder, run_clikgen)
    outcome = run_clikgen("analyse", "clik", "stretch.toml")
    assert outcome.returncode == 2
    assert len(outcome.stderr.strip().splitlines()) == 1
    assert "singular" in outcome.stderr


def test_scenario_for_another_controller_is_one_line(run_clikgen, in_folder):
    arm(in_folder, run_clikgen)
    outcome = run_clikgen("analyse", "clik", "paper", "--set", 'controller="arm2"')
    assert outcome.returncode == 2
    assert len(outcome.stderr.strip().splitlines()) == 1
    assert "q0: wanted 2 numbers for arm2, got 5" in outcome.stderr


MISTAKES = {
    "no time": (["filter", "--period", "0"], ["period", "0.0"]),
    "time runs back": (["clik", "paper", "--set", "period=-0.01"], ["period", "-0.01"]),
    "no cut-off": (["filter", "--cutoff", "0"], ["filter_cutoff", "0.0"]),
    "cut-off beyond Nyquist": (["filter", "--design", "51"], ["Nyquist", "51"]),
    "no controller": (["filter", "planar6"], ["planar6", "did you mean 'planar5'"]),
    "half a sample": (["clik", "paper", "--delay", "0.5"], ["delay", "0.5"]),
    "delay backward": (["clik", "paper", "--delay", "-1"], ["delay", "-1"]),
    "servo ahead of its time": (["clik", "paper", "--servo", "-0.1"], ["servo", "-0.1"]),
    "nothing to hit": (["chatter", "paper", "--set", "obstacles=[]"], ["no chatter to analyse"]),
    "diverges": (["chatter", "paper", "--set", "tool_gain=400"], ["case 1 diverged at t = 0.2"]),
    "too short": (["chatter", "paper", "--set", "duration=0.1", "--set", "metrics.f_h=20"], ["no point of interest"]),
    "no analysis": (["chatters", "paper"], ["chatters"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line(mistake, run_clikgen):
    arguments, wanted = MISTAKES[mistake]
    outcome = run_clikgen("analyse", *arguments)
    assert outcome.returncode == 2
    assert len(outcome.stderr.strip().splitlines()) == 1, outcome.stderr
    for piece in wanted:
        assert piece in outcome.stderr


def test_controller_without_a_tracking_task_is_one_line(run_clikgen, in_folder):
    text = SPEC.read_text().replace('name = "planar5"', 'name = "shy"', 1)
    tool = text[text.index('[[tasks]]\nname = "tool"') : text.index("[filter]")]
    (in_folder / "shy.toml").write_text(text.replace(tool, ""))
    assert run_clikgen("generate", "shy.toml").returncode == 0
    outcome = run_clikgen("analyse", "filter", "shy")
    assert outcome.returncode == 2
    assert outcome.stderr == "clikgen: error: shy: wanted a tracking task, got none\n"


def test_report_of_a_robot_that_tracks_a_pose_says_what_was_not_studied(run_clikgen, tmp_path):
    outcome = run_clikgen("analyse", "report", "shelf", "--set", "duration=2.0", "--json", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    document = json.loads(outcome.stdout)
    assert "frame_position" in document["CLIK loop"]["not_studied"]
    assert "Not studied" in (tmp_path / "report" / "report.html").read_text()
