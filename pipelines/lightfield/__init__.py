"""Floor 4: the scene model, and how it is made of posed photos.

``scene`` and ``scene_file`` hold the model in memory and on disk; ``plane_estimation`` and
``depth_maps`` find its surface, ``view_selection`` the photos that it needs, and ``stage`` makes it
of a reconstruction. ``areas`` divides a reconstruction, and ``world`` makes a scene of each part.
``views`` are its photos in the form in which they are rendered.
"""
