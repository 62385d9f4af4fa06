"""Floor 4: the light field: posed photos, a scene surface, and views rendered from them.

``scene`` and ``bundle`` hold the model in memory and on disk, ``plane_estimation`` finds its
surface. ``net``, ``blending``, ``proxy`` and ``reference`` are the readable renderer. The C++ core
is the fast one, which compares each view as soon as it is rendered; ``native_renderer`` leads to it
and ``renderer`` is its front. ``gpu_renderer`` does the same on a graphics card.
"""
