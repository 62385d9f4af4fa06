"""Floor 5: views of a light field, and their comparison with camera images.

``delaunay_mesh``, ``blending``, ``surface`` and ``reference`` are the readable renderer. The C++
core is the fast one, which compares each view as soon as it is rendered: ``native_renderer`` leads
to it and ``renderer`` is its front. ``gpu_renderer`` does the same on a GPU. What is compared are
``channels``, how is said by ``comparison``, and what a difference is worth by ``pixel_evidence``.
"""
