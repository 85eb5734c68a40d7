# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the campaign: trials that were survived, and recoveries, by plant."""

from fault_tables import singles, summary


def trial(fault: str, recovery: float | None, *complaints: str) -> dict:
    return {"fault": fault, "recovery": recovery, "complaints": list(complaints),
            "worst_speed": 100.0, "worst_slew": 399.5}


PLANTS = {
    "rolling": [
        trial("blind", 1.0), trial("blind", 3.0), trial("blind", None, "not at the goal"),
        trial("blind + frame", 4.0),
    ],
    "rigid_body": [trial("frame", 2.0)],
}


def test_single_faults_have_a_row_with_the_columns_of_each_plant() -> None:
    _, _, blind, frame = singles(PLANTS)
    assert blind == "| `blind` | 2 of 3 | 2.0 | 3.0 | 0 of 0 | - | - |"
    assert frame == "| `frame` | 0 of 0 | - | - | 1 of 1 | 2.0 | 2.0 |"


def test_summary_has_a_row_for_each_number_of_faults() -> None:
    _, _, one, two, contact = summary(PLANTS)
    assert one == "| `rolling` | one fault | 2 of 3 | 2.0 | 2.8 | 3.0 | 100.00 | 399.50 |"
    assert two.startswith("| `rolling` | two faults | 1 of 1 | 4.0 |")
    assert contact.startswith("| `rigid_body` | one fault | 1 of 1 |")
