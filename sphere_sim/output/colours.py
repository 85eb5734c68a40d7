# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Colours of pages, figures and models of the robot, and what each stands for.

They are those of Okabe and Ito, which people with any colour vision can distinguish.
"""

Colour = tuple[int, int, int]

BLUE: Colour = (0, 114, 178)
SKY: Colour = (86, 180, 233)
VERMILION: Colour = (213, 94, 0)
GREEN: Colour = (0, 158, 115)
PURPLE: Colour = (204, 121, 167)
YELLOW: Colour = (240, 228, 66)
ORANGE: Colour = (230, 159, 0)
INK: Colour = (38, 50, 62)
WHITE: Colour = (255, 255, 255)

ROTORS = (ORANGE, GREEN)
SERIES = (BLUE, VERMILION, PURPLE, SKY, INK)
"""Colours of other curves, such as runs, strategies and components, in this order."""
PATH = DISTANCE = BLUE
ANGLE = VERMILION
PLAN = SKY
GOAL = PURPLE
ESTIMATE = YELLOW
GAMMA = VERMILION
TRACE = INK
WALL: Colour = (92, 104, 118)


def linear(colour: Colour) -> Colour:
    """Return a colour in linear light, as lines need it.

    The page reads colours of lines as linear and converts them to sRGB for the screen.
    """
    red, green, blue = (round(255.0 * (part / 255.0) ** 2.2) for part in colour)
    return red, green, blue


def css(colour: Colour) -> str:
    """Return a colour in CSS notation."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
