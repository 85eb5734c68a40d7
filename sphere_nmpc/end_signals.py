# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Signals that ask a process to end, which all processes of this package treat alike."""

import signal

TERMINAL_SIGNALS = (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP)
"""From a terminal to all processes that run in it: Ctrl-C, Ctrl-\\ and its end."""
END_SIGNALS = (*TERMINAL_SIGNALS, signal.SIGTERM)
"""All of them."""
