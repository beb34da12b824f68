"""Identification: from logs of a robot to the plant that made them, with what is known of it."""
