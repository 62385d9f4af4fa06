"""Floor 4: the light field: posed photos, a scene surface, and views rendered from them.

``scene`` and ``bundle`` hold the model in memory and on disk, ``plane_estimation`` finds its
surface. ``net`` and ``reference`` are the readable renderer; ``net_kernels``, ``kernels`` and
``comparison`` the fast one that fuses rendering with the comparison; ``renderer`` is the front of
the fast one.
"""
