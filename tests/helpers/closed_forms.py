"""Light on a plane in closed form, for tests."""

import numpy as np

from geometries.leds import emitters


def polygon_irradiance(point, corners):
    """Irradiance at a point facing +z by a polygon of unit radiance (Lambert 1760), corners in order."""
    to = corners - point
    to = to / np.linalg.norm(to, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(to, np.roll(to, -1, axis=0), strict=True):
        edge = np.cross(a, b)
        total += np.arccos(np.clip(a @ b, -1, 1)) * edge[2] / np.linalg.norm(edge)
    return abs(total) / 2


def direct_radiance(design, x_mm, y_mm):
    """Radiance of the flat membrane under each group at unit flux, direct light alone."""
    strips = emitters(design.leds)
    area = [sum(s.area_mm2 for s in strips if s.group == g) for g in range(len(design.leds.groups))]
    radiance = np.zeros((len(area), *x_mm.shape))
    for strip in strips:
        centre, normal = np.array(strip.centre_mm), np.array(strip.normal)
        across = strip.half_width_mm * np.array(strip.across)
        down = strip.half_height_mm * np.array(strip.down)
        corners = centre + np.array([across + down, across - down, -across - down, down - across])
        for index in np.ndindex(x_mm.shape):
            at = np.array([x_mm[index], y_mm[index], 0.0])
            if (at - centre) @ normal > 0:  # in front of the strip
                emitted = polygon_irradiance(at, corners) / (np.pi * area[strip.group])
                radiance[(strip.group, *index)] += emitted
    albedo = np.array(design.per_group("membrane_albedo"))
    return albedo[:, None, None] / np.pi * radiance


def block_means(image, size):
    """Means over square blocks of images, shape (groups, rows, columns)."""
    groups, rows, columns = image.shape
    return image.reshape(groups, rows // size, size, columns // size, size).mean(axis=(2, 4))
