"""A new revision of a model: one effect more, judged on held-out motions."""
