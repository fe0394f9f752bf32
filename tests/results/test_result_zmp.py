"""The ZMP that a result exports is the certificate's, at knots and at the borders of phases too."""

import numpy as np
import pytest
from told_results import told_results

from service.result.motion_json import samples_of
from service.result.result_json import to_result_json
from service.verify.polygons import outside_polygon


@pytest.fixture(scope="module", params=["atlas waves", "atlas settles", "a wheel", "a wheel, too fast"])
def exported(request, tmp_path_factory):
    """A result, its JSON, and for each phase that stands on a polygon the check of its ZMP."""
    result = told_results(tmp_path_factory.mktemp("zmp"))[request.param]()
    checks = {check.name: check for check in result.certificate.checks}
    phases = [phase for phase in result.motion.phases if phase.support is not None]
    return result, to_result_json(result), [checks[f"zmp.{phase.name}"] for phase in phases]


def inside(entry, points):
    return -outside_polygon(np.array(entry["polygon"]), np.array(points))


def test_the_zmp_of_a_phase_has_the_certificates_worst_at_its_time(exported):
    _, data, checks = exported
    for entry, check in zip(data["support_polygons"], checks, strict=True):
        values = inside(entry, entry["zmp"]["points"])
        assert values.min() == pytest.approx(check.value, abs=1e-12)
        assert entry["zmp"]["times"][int(values.argmin())] == pytest.approx(check.where.time_s, abs=1e-12)


def test_the_zmp_at_the_samples_is_never_better_than_the_certificates(exported):
    _, data, checks = exported
    for entry, check in zip(data["support_polygons"], checks, strict=True):
        values = inside(entry, data["zmp"][entry["first"] : entry["last"] + 1])
        assert values.min() <= check.value + 1e-12


def test_times_run_through_the_whole_phase_and_are_at_most_two_a_sample(exported):
    result, data, _ = exported
    times = data["trajectory"]["times"]
    for entry in data["support_polygons"]:
        own = entry["zmp"]["times"]
        assert own[0] == pytest.approx(times[entry["first"]], abs=1e-6)
        assert own[-1] == pytest.approx(times[entry["last"]], abs=1e-6)
        assert np.all(np.diff(own) > 0.0)
        assert len(own) <= entry["last"] - entry["first"] + 3
    assert len(data["zmp"]) == len(samples_of(result.motion))


def test_an_untimed_motion_has_no_zmp(tmp_path):
    data = to_result_json(told_results(tmp_path)["past a post, untimed"]())
    assert set(map(type, data["zmp"])) == {type(None)}
