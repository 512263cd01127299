#!/usr/bin/env python3
"""Draws the figures of the book: docs/src/drawings/*.svg.

    docs/drawings/draw.py           writes every figure
    docs/drawings/draw.py --check   exit status 1 when a figure in the repository is not the one drawn here

Python's standard library only; the same figures on every machine. Every figure has a light ground of its own,
so that it can be read on a dark page too.
"""

import math
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent.parent / "src" / "drawings"

INK = "#1f2933"
GREY = "#7b8794"
PAPER = "#fbfaf6"
RED = "#b42318"
BLUE = "#1d4ed8"
GREEN = "#15803d"
BED = ("#d5d9df", "#bcc2cb", "#a9b0bb")
TABLE = ("#cfe3f7", "#a9cbea", "#8fb7dc")
CRADLE = ("#d9e6d2", "#b9cfae", "#a3bd96")
PART = ("#f5d9a8", "#e6bf7c", "#d4a95f")
TOOL = ("#e8d5ee", "#cfb3d9", "#bb9bc8")


class Figure:
    """SVG elements on a light ground."""

    def __init__(self, name, width, height, title):
        self.name, self.width, self.height = name, width, height
        self.parts = [f"<title>{escape(title)}</title>"]

    def svg(self):
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" '
            f'width="{self.width}" height="{self.height}" font-family="Helvetica, Arial, sans-serif" '
            f'font-size="15" fill="{INK}">'
        )
        ground = f'<rect width="{self.width}" height="{self.height}" rx="10" fill="{PAPER}"/>'
        return "\n".join([head, self.parts[0], ground, *self.parts[1:], "</svg>"]) + "\n"

    def add(self, element):
        self.parts.append(element)

    def polygon(self, points, fill, stroke=INK, width=1.0):
        self.add(
            f'<polygon points="{path_points(points)}" fill="{fill}" stroke="{stroke}" '
            f'stroke-width="{width}" stroke-linejoin="round"/>'
        )

    def line(self, points, stroke=INK, width=1.5, dash=None):
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self.add(
            f'<polyline points="{path_points(points)}" fill="none" stroke="{stroke}" '
            f'stroke-width="{width}" stroke-linecap="round" stroke-linejoin="round"{dashed}/>'
        )

    def arrow(self, points, stroke=INK, width=2.0, head=9.0, both=False):
        """A polyline with a head at its end (and at its start)."""
        points = list(points)
        tips = [(points[-2], points[-1])] + ([(points[1], points[0])] if both else [])
        shortened = list(points)
        for (before, tip), place in zip(tips, [-1, 0]):
            length = math.dist(before, tip)
            share = min(1.0, 0.7 * head / length)
            shortened[place] = tuple(t + (b - t) * share for b, t in zip(before, tip))
        self.line(shortened, stroke, width)
        for before, tip in tips:
            angle = math.atan2(tip[1] - before[1], tip[0] - before[0])
            corners = [tip] + [
                (tip[0] - head * math.cos(angle + turn), tip[1] - head * math.sin(angle + turn))
                for turn in (0.42, -0.42)
            ]
            self.polygon(corners, stroke, stroke, 0.5)

    def dot(self, point, radius=3.5, fill=INK):
        x, y = point
        self.add(f'<circle cx="{number(x)}" cy="{number(y)}" r="{number(radius)}" fill="{fill}"/>')

    def text(self, x, y, text, anchor="start", fill=INK, size=None, weight=None, halo=False):
        extra = (f' font-size="{size}"' if size else "") + (f' font-weight="{weight}"' if weight else "")
        if halo:
            extra += f' paint-order="stroke" stroke="{PAPER}" stroke-width="4" stroke-linejoin="round"'
        self.add(
            f'<text x="{number(x)}" y="{number(y)}" text-anchor="{anchor}" fill="{fill}"{extra}>{escape(text)}</text>'
        )

    def rectangle(self, x, y, width, height, fill, stroke=INK, radius=6):
        self.add(
            f'<rect x="{number(x)}" y="{number(y)}" width="{number(width)}" height="{number(height)}" '
            f'rx="{radius}" fill="{fill}" stroke="{stroke}"/>'
        )


class Space:
    """An oblique view: X to the right and to the front, Y to the right and to the back, Z up."""

    def __init__(self, figure, origin, scale, x=(0.93, 0.27), y=(0.66, -0.40)):
        self.figure, self.origin, self.scale, self.x, self.y = figure, origin, scale, x, y

    def at(self, point):
        x, y, z = point
        s = self.scale
        return (
            self.origin[0] + s * (x * self.x[0] + y * self.y[0]),
            self.origin[1] + s * (x * self.x[1] + y * self.y[1] - z),
        )

    def box(self, low, high, colours):
        """The three faces that are seen: top, front (low Y) and right (high X)."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        top, front, right = colours
        faces = [
            ([(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)], top),
            ([(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)], front),
            ([(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)], right),
        ]
        for corners, colour in faces:
            self.figure.polygon([self.at(c) for c in corners], colour)

    def disc(self, centre, radius, height, colours):
        """A cylinder that stands on `centre`."""
        x, y, z = centre

        def rim(level):
            return [
                self.at((x + radius * math.cos(t), y + radius * math.sin(t), level))
                for t in (math.tau * k / 72 for k in range(72))
            ]

        low, high = rim(z), rim(z + height)
        # The outline of the side: the lower rim's front half between the leftmost and rightmost points.
        left = min(range(72), key=lambda k: low[k][0])
        right = max(range(72), key=lambda k: low[k][0])
        front = [k % 72 for k in range(left, left + 72) if k <= (right if right > left else right + 72)]
        self.figure.polygon([low[k] for k in front] + [high[k] for k in reversed(front)], colours[1])
        self.figure.polygon(high, colours[0])

    def arrow(self, start, end, stroke=INK, width=2.0, head=9.0, both=False):
        self.figure.arrow([self.at(start), self.at(end)], stroke, width, head, both)

    def turn(self, centre, about, radius, start_deg, end_deg, stroke=INK, width=2.2, head=10.0):
        """An arrow round an axis, right-handed, from one angle to another."""
        points = []
        steps = 40
        for k in range(steps + 1):
            t = math.radians(start_deg + (end_deg - start_deg) * k / steps)
            c, s = radius * math.cos(t), radius * math.sin(t)
            offset = {"X": (0, c, s), "Y": (s, 0, c), "Z": (c, s, 0)}[about]
            points.append(self.at(tuple(a + b for a, b in zip(centre, offset))))
        self.figure.arrow(points, stroke, width, head)
        return points

    def line(self, start, end, **style):
        self.figure.line([self.at(start), self.at(end)], **style)

    def axes(self, origin, length):
        """The MCS directions."""
        for letter, end, colour, shift in [
            ("X", (length, 0, 0), RED, (8, 10)),
            ("Y", (0, length, 0), GREEN, (6, 0)),
            ("Z", (0, 0, length), BLUE, (-5, -8)),
        ]:
            tip = tuple(a + b for a, b in zip(origin, end))
            self.arrow(origin, tip, colour, 2.4)
            x, y = self.at(tip)
            self.figure.text(x + shift[0], y + shift[1], letter, fill=colour, weight="bold")


def number(value):
    text = f"{value:.1f}"
    return "0.0" if text == "-0.0" else text


def path_points(points):
    return " ".join(f"{number(x)},{number(y)}" for x, y in points)


def escape(text):
    # Several blanks in a row would be drawn as one.
    text = text.replace("  ", "\u2002")
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def leader(figure, start, end, text, anchor="start", size=14):
    """A thin line from a part to its name."""
    figure.line([start, end], GREY, 1.0)
    figure.dot(start, 2.2, GREY)
    shift = 5 if anchor == "start" else -5
    figure.text(end[0] + shift, end[1] + 5, text, anchor, size=size, halo=True)


def gantry():
    f = Figure("gantry", 760, 500, "A gantry, w X' b Y Z t")
    s = Space(f, (120, 315), 1.0, x=(0.92, 0.30), y=(0.62, -0.36))
    # Far column first, then the bed with its table, then the near column and all that hangs on the beam.
    s.box((150, 205, -30), (210, 255, 215), BED)
    s.box((0, 0, -30), (400, 200, 0), BED)
    s.box((70, 20, 0), (320, 180, 22), TABLE)
    s.box((150, 60, 22), (260, 140, 62), PART)
    ram_x, ram_y = 222, 100
    s.box((212, ram_y - 12, 78), (236, ram_y + 12, 165), TOOL)
    s.box((218, ram_y - 6, 64), (230, ram_y + 6, 78), ("#777f88", "#5c646d", "#4b525a"))
    s.box((150, -55, -30), (210, -5, 165), BED)
    s.box((150, -55, 165), (210, 255, 215), BED)
    s.box((210, ram_y - 35, 150), (240, ram_y + 35, 235), TOOL)
    s.box((210, ram_y - 12, 235), (238, ram_y + 12, 275), TOOL)
    # Motions.
    s.arrow((425, 60, 11), (335, 60, 11), RED, 3.0, 12)
    x, y = s.at((425, 60, 11))
    f.text(x + 12, y + 12, "+X: the table moves", fill=RED, size=14, weight="bold", halo=True)
    f.text(x + 12, y + 29, "towards −X, the tool goes", fill=RED, size=14, halo=True)
    f.text(x + 12, y + 46, "to +X over the workpiece", fill=RED, size=14, halo=True)
    s.arrow((240, 140, 215), (240, 225, 215), GREEN, 3.0, 12)
    x, y = s.at((240, 225, 215))
    f.text(x + 8, y + 2, "+Y", fill=GREEN, weight="bold")
    s.arrow((252, ram_y, 80), (252, ram_y, 140), BLUE, 3.0, 12)
    x, y = s.at((252, ram_y, 140))
    f.text(x + 8, y + 10, "+Z", fill=BLUE, weight="bold")
    s.axes((-55, -60, -60), 60)
    x, y = s.at((-55, -60, -60))
    f.text(24, y + 44, "MCS, fixed to the bed", size=13, fill=GREY)
    # Names.
    leader(f, s.at((60, 0, -15)), (200, 470), "b  bed with columns and beam")
    leader(f, s.at((85, 20, 11)), (112, 245), "X′ table", "end")
    leader(f, s.at((165, 60, 50)), (112, 205), "w  workpiece", "end")
    leader(f, s.at((225, ram_y - 35, 215)), (330, 50), "Y  carriage on the beam", "end")
    leader(f, s.at((226, ram_y, 272)), (540, 46), "Z  ram")
    leader(f, s.at((230, ram_y - 6, 68)), (600, 262), "t  tool")
    return f


def trunnion():
    f = Figure("trunnion", 760, 540, "A machine with a tilting table, w C' A' b X Y Z t")
    s = Space(f, (90, 375), 1.0, x=(0.94, 0.24), y=(0.60, -0.36))
    s.box((0, 0, -40), (420, 220, 0), BED)
    # Left bearing, cradle, table, right bearing.
    axis_z, centre = 92, (210, 110)
    s.box((20, 75, 0), (60, 145, 120), BED)
    s.box((75, 40, 30), (100, 180, 115), CRADLE)
    s.box((75, 40, 30), (345, 180, 58), CRADLE)
    s.disc((*centre, 58), 62, 18, TABLE)
    s.box((185, 85, 76), (235, 135, 116), PART)
    s.box((320, 40, 30), (345, 180, 115), CRADLE)
    s.box((360, 75, 0), (400, 145, 120), BED)
    # Centre lines.
    dash = "11 4 2 4"
    s.line((-40, 110, axis_z), (470, 110, axis_z), stroke=RED, width=1.6, dash=dash)
    s.line((*centre, 20), (*centre, 196), stroke=BLUE, width=1.6, dash=dash)
    # Spindle.
    s.disc((*centre, 212), 5, 34, ("#777f88", "#5c646d", "#4b525a"))
    s.disc((*centre, 246), 26, 30, TOOL)
    s.box((175, 75, 276), (245, 145, 330), TOOL)
    # Positive motions.
    s.turn((440, 110, axis_z), "X", 30, -60, 210, RED)
    x, y = s.at((470, 110, axis_z))
    f.text(x + 6, y + 20, "+A of the tool", fill=RED, size=14, weight="bold", halo=True)
    f.text(x + 6, y + 37, "over the workpiece", fill=RED, size=14, halo=True)
    s.turn((*centre, 172), "Z", 36, -150, 120, BLUE)
    x, y = s.at((*centre, 172))
    f.text(x + 48, y - 2, "+C of the tool over the workpiece:", fill=BLUE, size=14, weight="bold")
    f.text(x + 48, y + 15, "the table turns the other way", fill=BLUE, size=14)
    s.axes((300, 110, 262), 55)
    x, y = s.at((300, 110, 262))
    f.text(x + 72, y + 2, "X, Y, Z carry the tool", size=14)
    # Names.
    leader(f, s.at((60, 0, -20)), (150, 512), "b  bed with two bearings")
    leader(f, s.at((88, 40, 70)), (118, 280), "A′ cradle", "end")
    leader(f, s.at((165, 72, 70)), (330, 512), "C′ table on the cradle")
    leader(f, s.at((192, 85, 105)), (118, 240), "w  workpiece", "end")
    leader(f, s.at((205, 110, 230)), (150, 190), "t  tool", "end")
    point = s.at((210, 110, axis_z))
    f.line([point, (520, 262)], GREY, 1.0)
    f.dot(point, 4.5)
    f.text(525, 262, "here the lines cross: it can", size=14, halo=True)
    f.text(525, 279, "be the point of both axes", size=14, halo=True)
    return f


def chain():
    f = Figure("chain", 760, 400, "Structures as chains of boxes from the workpiece to the tool")
    rows = [
        ("w X′ b Y Z t", ["w", "X′", "b", "Y", "Z", "t"]),
        ("w C′ A′ b X Y Z t", ["w", "C′", "A′", "b", "X", "Y", "Z", "t"]),
        ("w C′ X′ b Y Z B t", ["w", "C′", "X′", "b", "Y", "Z", "B", "t"]),
    ]
    f.text(30, 36, "carries the workpiece (primes)", fill=BLUE, size=14)
    f.text(730, 36, "carries the tool", "end", fill="#7e3f98", size=14)
    middle, step, width = 380, 76, 56
    for k, (_, letters) in enumerate(rows):
        y = 56 + k * 84
        bed = letters.index("b")
        for place, letter in enumerate(letters):
            x = middle + (place - bed) * step - width / 2
            colours = PART if letter == "w" else BED if letter == "b" else TABLE if place < bed else TOOL
            if place:
                f.line([(x - step + width, y + 22), (x, y + 22)], GREY, 2.0)
            f.rectangle(x, y, width, 44, colours[0])
            f.text(x + width / 2, y + 29, letter, "middle", size=18, weight="bold")
            name = {"w": "workpiece", "b": "bed", "t": "tool"}.get(letter)
            if k == 0 and name:
                f.text(x + width / 2, y + 61, name, "middle", size=12, fill=GREY)
    f.line([(middle - width / 2 - 10, 44), (middle - width / 2 - 10, 294)], GREY, 1.0, "3 4")
    f.line([(middle + width / 2 + 10, 44), (middle + width / 2 + 10, 294)], GREY, 1.0, "3 4")
    f.text(30, 326, "One box of a linear axis, from left to right:  E M S left of b,  S M E right of b", size=14)
    f.text(30, 348, "One box of a rotary axis:  M E S left of b,  S E M right of b", size=14)
    f.text(30, 376, "E  error motions,  M  motion along or about the actual axis line,  S  assembly error", size=13, fill=GREY)
    return f


def error_motions():
    f = Figure("error-motions", 760, 430, "The six error motions of a carriage along X")
    s = Space(f, (70, 270), 1.0, x=(0.95, 0.20), y=(0.60, -0.40))
    s.box((0, 0, 0), (520, 22, 26), BED)
    s.box((0, 98, 0), (520, 120, 26), BED)
    s.box((150, -10, 26), (330, 130, 80), TABLE)
    centre = (240, 60, 80)
    f.dot(s.at(centre), 3.5)
    ends = {"X": (475, 60, 80), "Y": (240, 285, 80), "Z": (240, 60, 215)}
    colours = {"X": RED, "Y": GREEN, "Z": BLUE}
    for letter, end in ends.items():
        s.arrow(centre, end, colours[letter], 2.6, 11)
    x, y = s.at(ends["X"])
    f.text(x + 10, y + 4, "EXX positioning", fill=RED, weight="bold")
    x, y = s.at(ends["Y"])
    f.text(x + 10, y + 2, "EYX straightness in Y", fill=GREEN, weight="bold")
    x, y = s.at(ends["Z"])
    f.text(x - 12, y + 4, "EZX straightness in Z", "end", fill=BLUE, weight="bold")
    s.turn((415, 60, 80), "X", 26, -70, 200, RED)
    x, y = s.at((415, 60, 80))
    f.text(x - 6, y + 52, "EAX roll", "middle", fill=RED, weight="bold")
    s.turn((240, 235, 80), "Y", 26, -40, 230, GREEN)
    x, y = s.at((240, 235, 80))
    f.text(x + 36, y + 22, "EBX pitch", fill=GREEN, weight="bold")
    s.turn((240, 60, 180), "Z", 26, -150, 120, BLUE)
    x, y = s.at((240, 60, 180))
    f.text(x - 38, y + 6, "ECX yaw", "end", fill=BLUE, weight="bold")
    s.arrow((20, -60, 0), (120, -60, 0), INK, 2.0)
    x, y = s.at((20, -60, 0))
    f.text(x - 6, y + 36, "coordinate x", size=14)
    f.text(30, 36, "Each is a curve over x, along or about the MCS axes through the point of the axis (black dot).", size=14)
    f.text(30, 56, "Arrows show the positive sense of the tool side seen from the workpiece side.", size=14, fill=GREY)
    return f


def squareness():
    f = Figure("squareness", 760, 340, "Squareness EC0Y, positive")
    ox, oy = 330, 280
    f.arrow([(ox, oy), (640, oy)], RED, 2.6, 11)
    f.text(650, oy + 5, "X", fill=RED, weight="bold")
    f.line([(ox, oy), (ox, 50)], GREY, 1.6, "7 5")
    f.text(ox + 8, 56, "nominal Y", fill=GREY, size=14)
    tilt = 0.34
    length = 235
    end = (ox - length * math.sin(tilt), oy - length * math.cos(tilt))
    f.arrow([(ox, oy), end], GREEN, 2.6, 11)
    f.text(end[0] - 12, end[1] + 4, "actual Y", "end", fill=GREEN, weight="bold")

    def arc(radius, start, end_, steps=30):
        angles = [start + (end_ - start) * k / steps for k in range(steps + 1)]
        return [(ox + radius * math.cos(t), oy - radius * math.sin(t)) for t in angles]

    f.arrow(arc(150, math.pi / 2, math.pi / 2 + tilt), INK, 2.0, 10)
    x, y = arc(172, math.pi / 2, math.pi / 2 + tilt / 2)[-1]
    f.text(x, y - 2, "EC0Y", "middle", weight="bold", halo=True)
    f.arrow(arc(62, 0.0, math.pi / 2 + tilt), GREY, 1.6, 9)
    f.text(ox + 62, oy - 52, "90° + EC0Y", size=14, fill=GREY)
    f.text(420, 90, "Positive EC0Y turns Y right-handed about Z:", size=14)
    f.text(420, 110, "the angle from X to Y opens.", size=14)
    f.text(420, 140, "At Y = y the tool stands at", size=14)
    f.text(420, 162, "Δx = −EC0Y · y", size=16, weight="bold")
    f.text(420, 190, "12 µrad over 500 mm: −6 µm", size=14, fill=GREY)
    f.dot((ox, oy), 4)
    f.text(ox - 10, oy + 22, "Y = 0: no effect", "end", size=13, fill=GREY)
    return f


def abbe():
    f = Figure("abbe", 760, 360, "The Abbe offset: a tilt acts through the lever")
    f.rectangle(40, 290, 640, 22, BED[1], INK, 3)
    f.text(48, 333, "guideway along X", size=13, fill=GREY)
    cx, cy = 330, 248

    def turned(x, y, angle):
        return (cx + x * math.cos(angle) + y * math.sin(angle), cy - y * math.cos(angle) + x * math.sin(angle))

    # Positive EBX turns Z towards X: clockwise in this view (X to the right, Z up).
    tilt = 0.14
    for angle, fill, stroke, dash in [(0.0, "none", GREY, "6 4"), (tilt, TABLE[0], INK, None)]:
        corners = [turned(x, y, angle) for x, y in [(-90, -26), (90, -26), (90, 26), (-90, 26)]]
        if dash:
            f.line(corners + corners[:1], stroke, 1.3, dash)
        else:
            f.polygon(corners, fill, stroke, 1.3)
    top = 170
    ideal, actual = turned(0, top, 0.0), turned(0, top, tilt)
    f.line([(cx, cy), ideal], GREY, 1.3, "6 4")
    f.line([(cx, cy), actual], INK, 2.2)
    f.dot((cx, cy), 5)
    leader(f, (cx, cy), (cx + 118, cy - 4), "point of the axis")
    f.dot(ideal, 4, GREY)
    f.dot(actual, 5, RED)
    f.arrow([(ideal[0], ideal[1] - 16), (actual[0], ideal[1] - 16)], RED, 2.2, 8)
    f.text(actual[0] + 14, actual[1] - 10, "Δx = EBX · L", fill=RED, weight="bold", size=16)
    f.text(actual[0] + 14, actual[1] + 12, "functional point (tool tip, measured point)", size=14)
    x = cx - 120
    f.arrow([(x, cy), (x, ideal[1])], INK, 1.6, 9, both=True)
    f.line([(x - 8, ideal[1]), (cx - 8, ideal[1])], GREY, 1.0, "2 4")
    f.line([(x - 8, cy), (cx - 130 + 20, cy)], GREY, 1.0, "2 4")
    f.text(x - 12, (cy + ideal[1]) / 2 + 5, "lever L", "end", size=15)
    arc = [(cx + 130 * math.sin(tilt * k / 12), cy - 130 * math.cos(tilt * k / 12)) for k in range(13)]
    f.arrow(arc, GREEN, 2.0, 7)
    f.text(arc[-1][0] + 10, arc[-1][1] + 6, "EBX", fill=GREEN, weight="bold")
    f.text(470, 150, "20 µrad at a lever of 400 mm: 8 µm.", size=14, fill=GREY)
    f.text(470, 170, "The same carriage measured at its point", size=14, fill=GREY)
    f.text(470, 188, "shows nothing of it.", size=14, fill=GREY)
    f.arrow([(600, 272), (670, 272)], RED, 2.2, 9)
    f.text(676, 277, "X", fill=RED, weight="bold")
    return f


def reversal():
    f = Figure("reversal", 760, 360, "A bidirectional curve and the branch that is used")
    left, right, zero = 70, 430, 190

    def curve(shift):
        points = []
        for k in range(61):
            u = k / 60
            value = 70 * math.sin(2.6 * u) * u + 20 * math.sin(7 * u) + shift
            points.append((left + (right - left) * u, zero + 40 - value))
        return points

    f.arrow([(left - 20, zero + 90), (right + 30, zero + 90)], INK, 1.6)
    f.text(right + 26, zero + 112, "coordinate", "end", size=14)
    f.arrow([(left - 10, zero + 100), (left - 10, 60)], INK, 1.6)
    f.text(left - 2, 58, "error", size=14)
    forward, backward, mean = curve(26), curve(-26), curve(0)
    f.line(forward, RED, 2.6)
    f.line(backward, BLUE, 2.6)
    f.line(mean, GREY, 1.6, "6 5")
    f.arrow(forward[40:47], RED, 2.6, 12)
    f.arrow(list(reversed(backward[40:47])), BLUE, 2.6, 12)
    f.text(right + 8, forward[-1][1] + 2, "forward ↑", fill=RED, weight="bold")
    f.text(right + 8, mean[-1][1] + 5, "mean", fill=GREY)
    f.text(right + 8, backward[-1][1] + 8, "backward ↓", fill=BLUE, weight="bold")
    x = forward[18][0]
    f.arrow([(x, forward[18][1]), (x, backward[18][1])], INK, 1.6, 8, both=True)
    f.text(x + 8, (forward[18][1] + backward[18][1]) / 2 + 5, "B", weight="bold", halo=True)
    f.text(540, 92, "B = forward − backward", size=15, weight="bold")
    f.text(540, 114, "forward = mean + B/2", size=14)
    f.text(540, 134, "backward = mean − B/2", size=14)
    f.text(540, 252, "The direction of the last motion", size=14)
    f.text(540, 270, "selects the branch and is held", size=14)
    f.text(540, 288, "while the axis stands. No motion", size=14)
    f.text(540, 306, "yet: the mean is used.", size=14)
    f.text(30, 30, "Reversal value B of ISO 230-2 and the two branches of a curve", size=15)
    return f


FIGURES = [gantry, trunnion, chain, error_motions, squareness, abbe, reversal]


def main():
    check = sys.argv[1:] == ["--check"]
    if sys.argv[1:] and not check:
        sys.exit(__doc__)
    different = []
    for draw in FIGURES:
        figure = draw()
        path = FOLDER / f"{figure.name}.svg"
        if not check:
            FOLDER.mkdir(parents=True, exist_ok=True)
            path.write_text(figure.svg(), encoding="utf-8")
        elif not path.is_file() or path.read_text(encoding="utf-8") != figure.svg():
            different.append(path.name)
    expected = {f"{draw().name}.svg" for draw in FIGURES}
    different += sorted(p.name for p in FOLDER.glob("*.svg") if p.name not in expected)
    if different:
        print("not as drawn by docs/drawings/draw.py: " + ", ".join(different), file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
