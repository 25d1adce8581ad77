"""Design of the experiments: what to drive, and what each part of it will tell."""

from stopset.offline.plan.design import Plan, Wishes, design
from stopset.offline.plan.files import write_plan

__all__ = ["Plan", "Wishes", "design", "write_plan"]
