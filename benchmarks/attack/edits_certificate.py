"""Edits of the certificate, the verdict and the printed figures, and edits without effect."""

from __future__ import annotations

from benchmarks.attack.forgery import Folder, Level, Registry

CERTIFICATE = Registry()
ALL = ("arm", "untimed", "program", "reach", "carry", "valve")
RAW = Level.RAW


@CERTIFICATE.lie(*ALL, level=RAW, stranger=True)
def certificate_removed(folder: Folder) -> None:
    folder.data["certificate"] = None


@CERTIFICATE.lie("arm", level=RAW)
def certificate_key_deleted(folder: Folder) -> None:
    del folder.data["certificate"]


@CERTIFICATE.lie("arm", "reach", level=RAW)
def certificate_without_content(folder: Folder) -> None:
    folder.data["certificate"] = {}


@CERTIFICATE.lie("arm", "reach", "valve", level=RAW)
def certificate_and_pieces_removed(folder: Folder) -> None:
    folder.data.update(certificate=None, pieces=[])


@CERTIFICATE.lie("arm", "reach", "valve", level=RAW)
def certificate_and_targets_removed(folder: Folder) -> None:
    folder.data["certificate"] = None
    for phase in folder.phases:
        phase["targets"] = []


@CERTIFICATE.lie("reach", "carry", "valve", level=RAW)
def certificate_contacts_and_support_removed(folder: Folder) -> None:
    folder.data["certificate"] = None
    for phase in folder.phases:
        phase.update(contacts=[], support=None)


@CERTIFICATE.lie("arm", "reach", "valve", level=RAW)
def certificate_pieces_targets_and_contacts_removed(folder: Folder) -> None:
    folder.data.update(certificate=None, pieces=[p for p in folder.data["pieces"] if p["name"] == "floor"])
    for phase in folder.phases:
        phase.update(contacts=[], support=None, targets=[])


@CERTIFICATE.lie("arm", "reach", "valve", level=RAW)
def recorded_status_violated(folder: Folder) -> None:
    folder.certificate["status"] = "VIOLATED"


@CERTIFICATE.lie("arm", "reach", level=RAW)
def a_recorded_check_has_failed(folder: Folder) -> None:
    folder.certificate["checks"][-1]["ok"] = False


@CERTIFICATE.lie("arm", "reach", level=RAW)
def hashes_of_the_certificate_deleted(folder: Folder) -> None:
    for name in [name for name in folder.certificate if name.endswith("_sha256")]:
        del folder.certificate[name]
    folder.data["pieces"][0]["vertices"] = [[x, y, z - 5.0] for x, y, z in folder.data["pieces"][0]["vertices"]]


@CERTIFICATE.lie("arm", "reach", "valve", level=RAW)
def checks_of_the_certificate_emptied(folder: Folder) -> None:
    folder.certificate["checks"] = []
    for phase in folder.phases:
        phase["targets"] = []


@CERTIFICATE.lie("arm", "reach", level=RAW)
def clearance_claimed_too_large(folder: Folder) -> None:
    folder.data["min_clearance_m"] = folder.certificate["min_clearance_m"] = 0.5


@CERTIFICATE.lie("reach", level=RAW)
def balance_claimed_too_large(folder: Folder) -> None:
    folder.data["min_balance_margin_m"] = folder.certificate["min_balance_margin_m"] = 0.5


@CERTIFICATE.lie("reach", "valve", level=RAW)
def exempt_pairs_no_longer_listed(folder: Folder) -> None:
    folder.data["exempt"] = []
    folder.certificate["exempt"] = []


@CERTIFICATE.lie("arm", "reach", level=RAW)
def checks_beside_the_certificate_embellished(folder: Folder) -> None:
    for check in folder.data["checks"]:
        check.update(value=0.0, text="nothing comes near anything")


@CERTIFICATE.lie("valve", level=RAW)
def a_turn_of_60_degrees_called_360(folder: Folder) -> None:
    folder.data["figures"]["turned_deg"] = 360.0


@CERTIFICATE.lie("reach", level=RAW)
def zmp_drawn_in_the_middle(folder: Folder) -> None:
    folder.data["zmp"] = [[0.0, 0.0] for _ in folder.data["zmp"]]


@CERTIFICATE.lie("reach", level=RAW)
def centre_of_mass_drawn_in_the_middle(folder: Folder) -> None:
    folder.data["com"] = [[0.0, 0.0, 1.0] for _ in folder.data["com"]]


@CERTIFICATE.lie("reach", level=RAW)
def support_polygons_drawn_larger(folder: Folder) -> None:
    for support in folder.data["support_polygons"]:
        support["polygon"] = [[3.0 * x, 3.0 * y] for x, y in support["polygon"]]


@CERTIFICATE.for_stranger("arm", "reach")
def clearance_proof_claims_a_metre_everywhere(folder: Folder) -> None:
    stretches = folder.certificate["stretches"]
    stretches["distance"] = [1.0 for _ in stretches["distance"]]
    stretches["floors"] = [1.0 for _ in stretches["floors"]]


@CERTIFICATE.lie("arm", level=RAW)
def format_of_another_version(folder: Folder) -> None:
    folder.data["format"] = "scopt-result/0"


@CERTIFICATE.lie("missed", level=RAW)
def verdict_of_a_missed_goal_changed(folder: Folder) -> None:
    folder.data["verdict"] = "CERTIFIED"


@CERTIFICATE.lie("missed")
def goal_that_was_missed_removed(folder: Folder) -> None:
    for phase in folder.phases:
        phase["targets"] = []


@CERTIFICATE.lie("missed")
def goal_that_was_missed_loosened(folder: Folder) -> None:
    for target in folder.targets("pose"):
        target["position_tolerance_m"] = [1.0, 1.0, 1.0]


@CERTIFICATE.lie("missed")
def goal_that_was_missed_loosened_in_the_request_but_not_enough(folder: Folder) -> None:
    for target in folder.targets("pose"):
        target["position_tolerance_m"] = [1.0, 1.0, 1.0]
    folder.request["goal"]["poses"][0]["position_tolerance_m"] = 0.15


@CERTIFICATE.harmless(*ALL, "scan")
def notes_changed(folder: Folder) -> None:
    folder.data["notes"] = ["read by a person"]


@CERTIFICATE.harmless("arm", "reach")
def timings_changed(folder: Folder) -> None:
    folder.data.update(planning_time_s=1.0, timings={"total": 1.0})


@CERTIFICATE.harmless("arm")
def where_it_was_found_changed(folder: Folder) -> None:
    folder.data["found_from"] = "somewhere"


@CERTIFICATE.harmless(*ALL, "scan", level=Level.REMADE)
def everything_written_once_more(folder: Folder) -> None:
    folder.data["notes"] = ["written once more"]


@CERTIFICATE.harmless("arm", "reach")
def keys_in_another_order(folder: Folder) -> None:
    folder.data = dict(sorted(folder.data.items(), reverse=True))
    folder.data = {"format": folder.data.pop("format"), **folder.data}


@CERTIFICATE.harmless("arm")
def views_deleted(folder: Folder) -> None:
    (folder.path / "viewer.html").unlink()
    (folder.path / "scene.glb").unlink()
