"""Tables of limits, alarms and baselines: contradictions are refused in one line that names key and value."""

import pytest

from creak.alarm_records import AlarmRules, BaselineRules, Limits
from creak.config.service import parse_service
from creak.config.validation import parse_toml
from creak.errors import ConfigurationError

HEAD = """
[[rigs]]
rig = "rig.toml"
model = "model.toml"
window = 4
[rigs.source]
kind = "simulated"
"""


def parse(text, tmp_path):
    return parse_service(parse_toml(HEAD + text, "creak.toml"), "creak.toml", tmp_path).rigs[0]


def test_nothing_given_is_the_records_defaults(tmp_path):
    """Kills a default written twice and changed once."""
    table = parse("", tmp_path)
    assert table.limits.limits() == Limits()
    assert table.alarms.rules() == AlarmRules()
    assert table.baseline.rules(table.window) == BaselineRules()


def test_what_is_given_arrives(tmp_path):
    text = """
[rigs.limits]
warning_db = 1.5
false_alarms_per_year = 0.5
[rigs.alarms]
on_delay_s = 60
realarm_s = 3600
[rigs.baseline]
realisations = 100
trend_false_alarms_per_year = 2
"""
    table = parse(text, tmp_path)
    assert table.limits.limits() == Limits(warning_db=1.5, false_alarms_per_year=0.5)
    assert table.alarms.rules() == AlarmRules(on_delay_s=60, realarm_s=3600)
    assert table.baseline.rules(4) == BaselineRules(realisations=100, trend_false_alarms_per_year=2)


@pytest.mark.parametrize(
    ("table", "line", "says"),
    [
        ("limits", "warning_db = 3.0", ["warning_db", "3", "less than 'total_to_noise_db'"]),
        ("limits", "p_value = 0.01\nfalse_alarms_per_year = 1", ["p_value", "0.01", "false_alarms_per_year"]),
        ("limits", "windows = 2\nexceeding = 3", ["exceeding", "3", "at most 'windows' (2)"]),
        ("limits", "false_alarms_per_year = 0", ["false_alarms_per_year", "0", "greater than 0"]),
        ("limits", "dead_band_db = -1", ["dead_band_db", "-1"]),
        ("limits", "p_value = nan", ["p_value", "nan"]),
        ("alarms", "on_delay_s = -1", ["on_delay_s", "-1"]),
        ("alarms", "shelving_max_s = inf", ["shelving_max_s", "inf"]),
        ("alarms", "stale_realisations = 1", ["stale_realisations", "1", "2"]),
        ("alarms", "silence = 3", ["alarms.silence", "not a known key"]),
        ("baseline", "realisations = 15", ["baseline.realisations", "15", "at least 16"]),
        ("baseline", "realisations = 100.5", ["realisations", "100.5"]),
        ("baseline", "change_db = 0", ["change_db", "0", "greater than 0"]),
    ],
)
def test_contradictions_are_refused(table, line, says, tmp_path):
    with pytest.raises(ConfigurationError) as refused:
        parse(f"[rigs.{table}]\n{line}\n", tmp_path)
    message = str(refused.value)
    assert message.startswith("creak.toml: rigs[0]")
    assert "\n" not in message
    for part in says:
        assert part in message
