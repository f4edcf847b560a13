"""A synthetic performer: a dressed body rendered by Mitsuba's path tracer, written as a capture."""
