"""Alarms: what windows and data demand, and the life of each alarm, as pure functions of recorded time."""

from creak.alarms.judge import NodeAlarm, judge, step
from creak.alarms.life import Alarm, act, action_of, advance, demand, end, of_change

__all__ = ["Alarm", "NodeAlarm", "act", "action_of", "advance", "demand", "end", "judge", "of_change", "step"]
