"""The guided bench session: what to do next, and why, until every target is met."""
