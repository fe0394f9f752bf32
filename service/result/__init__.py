"""A plan's result and its files.

``result`` is the result, ``attempt`` the best one during a plan.  ``result_json`` is the content of ``result.json``, of
which ``motion_json``, ``phase_json``, ``zmp_json`` and ``obstruction`` are parts.  ``output`` writes the result folder,
``folder`` names, replaces and reads it.  ``scene_output`` writes the files of ``scopt scene``.
"""
