"""The compiled renderer: intersection, texture filtering, light, motion blur and anti-aliasing.

Entry points, in the order of use: `baking` (light on surfaces, once for a world), then for each
image `casting` (one ray for each pixel), `edges` (pixels that an edge passes) and `antialiasing`
(motion blur, more rays at edges). All other modules hold functions that are inlined into these.

Conventions:

- Rays start at the camera as (x, y, 1) in its frame, so that the ray parameter t of a hit,
  `start + t * ray`, is the depth of the point. Between other points, t = 1 is the end.
- A surface has a number: 6 * solid + face for solids, `ground_number(world)` for the ground, SKY
  or NOTHING (no ray: outside the image circle of the lens). Face 2 * axis + (1 if its outward
  normal points along the axis) of a box; 4 and 5 are also the ends of a cylinder, whose side is 0;
  an ellipsoid has face 0 only.
- `phase` is the time within the exposure of a row, from -0.5 at its start to 0.5 at its end.
- Vectors are tuples of floats and stay in registers; arrays are for what is shared or indexed.
"""
