"""Draws the lines of a mesh with Blender's Freestyle, to lay beside surfcut's (docs/measurements.md, *Styles*).

    blender -b --factory-startup -P docs/freestyle.py -- MESH.ply CAMERA.json OUT.png SIZE visible|hidden CREASE_DEGREES

CAMERA.json has `eye`, `target`, `up` and `fovy` (degrees), as beside the scenes of the peers' harness.
"""

import json
import math
import sys

import bpy
from mathutils import Matrix, Vector

mesh, camera, out, size, which, crease = sys.argv[sys.argv.index("--") + 1 :]
camera = json.load(open(camera))

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_mesh.ply(filepath=mesh)
body = bpy.context.selected_objects[0]
scene = bpy.context.scene

# Nothing but lines: a white body before a white world.
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.use_denoising = 1, False
scene.view_settings.view_transform = "Standard"
scene.world = bpy.data.worlds.new("white")
scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs[0].default_value = (1, 1, 1, 1)
white = bpy.data.materials.new("white")
white.use_nodes = True
nodes = white.node_tree.nodes
nodes.clear()
emission, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
emission.inputs[0].default_value = (1, 1, 1, 1)
white.node_tree.links.new(emission.outputs[0], output.inputs[0])
body.data.materials.clear()
body.data.materials.append(white)

# The camera, whose axes are right, up and backward.
eye, target, up = (Vector(camera[key]) for key in ("eye", "target", "up"))
forward = (target - eye).normalized()
right = forward.cross(up).normalized()
axes = Matrix((right, right.cross(forward), -forward)).transposed().to_4x4()
axes.translation = eye
lens = bpy.data.cameras.new("lens")
lens.sensor_fit, lens.angle = "VERTICAL", math.radians(camera["fovy"])
lens.clip_start, lens.clip_end = 0.01, 10000
scene.camera = bpy.data.objects.new("camera", lens)
scene.camera.matrix_world = axes
scene.collection.objects.link(scene.camera)
scene.render.resolution_x = scene.render.resolution_y = int(size)

# Silhouettes, borders and creases, one pixel wide; hidden ones dashed.
scene.render.use_freestyle = True
freestyle = scene.view_layers[0].freestyle_settings
freestyle.crease_angle = math.radians(180 - float(crease))
for lines in list(freestyle.linesets):
    freestyle.linesets.remove(lines)


def draw(visibility, alpha, dashed):
    lines = freestyle.linesets.new(visibility)
    lines.visibility = visibility
    lines.select_silhouette = lines.select_border = lines.select_crease = True
    style = lines.linestyle = bpy.data.linestyles.new(visibility)
    style.thickness, style.color, style.alpha = 1, (0, 0, 0), alpha
    style.use_dashed_line, style.dash1, style.gap1 = dashed, 4, 3


draw("VISIBLE", 1, False)
if which == "hidden":
    draw("HIDDEN", 0.45, True)

scene.render.filepath, scene.render.image_settings.file_format = out, "PNG"
bpy.ops.render.render(write_still=True)
