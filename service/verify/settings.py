"""What the verifier may spend and how finely it looks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class VerifySettings:
    """Settings of a verification; none of them can make a false claim pass.

    Attributes:
        max_halvings: how often a stretch between two knots may be halved before it counts as unproven.
        max_sharpenings: how often a proven stretch may be halved only to know the smallest margin more closely.
        max_stretches: how many narrow-phase stretches may be looked at in all.
        clearance_horizon_m: clearances are reported up to this distance.
        resolution_m: the smallest clearance is reported to within this.
        contact_tolerance_m: a sampled pose refutes the motion when it penetrates deeper than allowed by this.
        rounding: error of a coordinate as written to the result file [rad, m].
        time_step_s: forces and ZMP are sampled at least this often.
        limit_tolerance: relative excess over a speed or acceleration limit that still counts as within it.
    """

    max_halvings: int = 12
    max_sharpenings: int = 4
    max_stretches: int = 60_000
    clearance_horizon_m: float = 0.1
    resolution_m: float = 1e-3
    contact_tolerance_m: float = 1e-6
    rounding: float = 1e-8
    time_step_s: float = 0.01
    limit_tolerance: float = 1e-6
