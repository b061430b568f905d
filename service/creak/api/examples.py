"""An example of every answer about rigs, alarms and recordings, for the OpenAPI document."""

from typing import Any

Json = dict[str, Any]

_LEVELS: Json = {
    "name": "3",
    "signal_db": -41.2,
    "noise_db": -88.9,
    "total_db": -77.4,
    "nonlinear_db": -77.7,
    "total_to_noise_db": 11.5,
    "classical_total_to_noise_db": 29.8,
    "p_value": 1e-12,
    "classical_noise_db": -88.7,
    "classical_total_db": -58.9,
}
_SUMMARY: Json = {
    "name": "beam",
    "run": "beam-20260501T080000Z",
    "status": "running",
    "message": "",
    "source": "simulated",
    "software": "0.1.0",
    "start": "2026-05-01T08:00:00.000000Z",
    "last": "2026-05-01T08:14:24.000000Z",
    "end": None,
    "heard_at": "2026-05-01T08:14:24.310000Z",
    "nodes": ["1", "2", "3"],
    "frames": 108,
    "rejected_frames": 0,
    "transient_frames": 108,
    "realisations": 12,
    "experiments": 36,
    "faults": {"lost": 1},
    "alarms": {"3": "unacknowledged"},
}
_FAULT: Json = {
    "kind": "lost",
    "time": "2026-05-01T08:02:12.000000Z",
    "message": "period 1 of experiment 0 of realisation 2 never came",
    "realisation": 2,
    "experiment": 0,
    "period": 1,
}
ALARM: Json = {
    "id": "9f3c1b6e",
    "rig": "beam",
    "node": "3",
    "class": "process",
    "severity": "alarm",
    "state": "unacknowledged",
    "active": True,
    "acknowledged": False,
    "shelved": False,
    "since": "2026-05-01T08:12:00.000000Z",
    "level_db": 11.2,
    "event": "raised",
    "time": "2026-05-01T08:12:00.000000Z",
    "version": 1,
    "condition": "level",
    "by": "",
    "comment": "",
    "shelved_until": None,
    "suppressed": False,
    "out_of_service": False,
    "latched": False,
    "guidance": "Inspect the node for looseness, rubbing, cracks and worn bearings.",
}
_ABOUT: Json = {"rig": "beam", "scope": "window", "time": "2026-05-01T08:14:24.000000Z"}

NODE: Json = {**_LEVELS, "alarm": "unacknowledged", **_ABOUT, "realisations": 4, "input": "A", "output": "m/s^2"}
NODE["detection"] = {"excited_db": -74.2, "odd_db": -101.3, "even_db": None, "noise_db": -120.4}
RIG_PAGE: Json = {"items": [_SUMMARY], "next": None}
RIG_DETAIL: Json = {
    **_SUMMARY,
    "configuration": 'name = "beam"\n...',
    "excitation": {"kind": "multisine", "rms": 0.02, "seed": 1},
    "limits": {"total_to_noise_db": 3.0, "p_value": 0.001, "dead_band_db": 1.0, "windows": 3, "exceeding": 2},
    "sample_rate": 4096.0,
    "period_samples": 16384,
    "steady_periods": 3,
    "window": 4,
    "lines": 2000,
    "recent_faults": [_FAULT],
    "quality": [{"kind": "stuck", "message": "realisation 3: response 2 does not change ...", "findings": 1}],
}
NODE_PAGE: Json = {"items": [NODE], "next": None}
ELEMENT_PAGE: Json = {
    "items": [{"between": ["3", "ground"], "share": 0.99, "confidence": 0.999, "separable": True}],
    "next": None,
    **_ABOUT,
    "located": True,
    "unavailable": [],
    "remarks": [],
}
HISTORY_PAGE: Json = {
    "items": [{**_LEVELS, "run": _SUMMARY["run"], "scope": "window", "realisation": 11, "time": _ABOUT["time"]}],
    "next": "WyJhMWIyYzNkNGU1ZjYiLDQyXQ",
}
SPECTRUM: Json = {
    **_ABOUT,
    "name": "3",
    "realisations": 4,
    "frequency_hz": [0.25, 0.5],
    "signal_db": [-61.3, -58.8],
    "noise_db": [-121.9, -122.2],
    "total_db": [-110.4, -111.0],
    "nonlinear_db": [-110.7, -111.3],
    "classical_noise_db": [-121.7, -122.0],
    "classical_total_db": [-92.1, -91.5],
    "classical_nonlinear_db": [-92.1, None],
    "p_value": [3e-6, 0.4],
    "q_value": [2e-5, 0.7],
    "classical_p_value": [1e-12, 0.2],
    "false_discovery_rate": 0.05,
    "significant": [True, False],
    "bands": [{"from_hz": 0.25, "to_hz": 0.5, "lines": 2, "p_value": 1e-5, "classical_p_value": 1e-11}],
}
ALARM_PAGE: Json = {"items": [ALARM], "next": None}
ALARM_DETAIL: Json = {**ALARM, "changes": [ALARM]}
RECORDING_PAGE: Json = {
    "items": [
        {
            "id": "beam-20260501T080000Z-000",
            "rig": "beam",
            "run": _SUMMARY["run"],
            "path": "var/beam/beam-20260501T080000Z-000.mcap",
            "status": "writing",
            "size": 31457280,
            "start": _SUMMARY["start"],
            "end": None,
        }
    ],
    "next": None,
}
PROBLEM: Json = {
    "type": "urn:problem-type:creak:unknown-rig",
    "title": "Unknown rig",
    "status": 404,
    "detail": "there is no rig 'bench'",
    "instance": "/api/v1/rigs/bench",
}
