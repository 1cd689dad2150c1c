/* SPDX-License-Identifier: MIT */
/* sphere.h: the scene of gl_host.c, a sphere of radius 1 around 0 with z up, traced in the fragment
 * shader. Camera, tiles and light are those of `btf render`, so that the pictures can be compared. */
#ifndef EXAMPLE_SPHERE_H
#define EXAMPLE_SPHERE_H

/* A triangle over the whole picture. */
static const char sphere_vertices[] = "out vec2 screen;\n"
                                      "void main() {\n"
                                      "  screen = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;\n"
                                      "  gl_Position = vec4(screen, 0.0, 1.0);\n"
                                      "}\n";

/* After the model's shader. `light` is a direction in the camera's axes: right, up and back to the eye. */
static const char sphere_fragments[] =
    "uniform vec3 light;\n"
    "in vec2 screen;\n"
    "out vec4 color;\n"
    "const float pi = 3.14159265, distance_of_eye = 3.6;\n"
    "const mat3 camera = mat3(1.0, 0.0, 0.0, 0.0, 0.34202014, 0.93969262, 0.0, -0.93969262, 0.34202014);\n"
    "void main() {\n"
    "  vec3 eye = camera[2] * distance_of_eye;\n"
    "  vec3 ray = camera * normalize(vec3(screen * tan(radians(18.0)), -1.0));\n"
    "  float nearest = -dot(eye, ray), inside = nearest * nearest + 1.0 - dot(eye, eye);\n"
    "  vec3 position = eye + (nearest - sqrt(max(inside, 0.0))) * ray;\n"
    /* The frame of a point: along growing u, along growing v, and the normal. */
    "  vec3 normal = normalize(position), tangent = normalize(vec3(-normal.y, normal.x, 0.0));\n"
    "  mat3 frame = mat3(tangent, cross(normal, tangent), normal);\n"
    "  vec3 to_light = (camera * normalize(light)) * frame, to_eye = -ray * frame;\n"
    /* Three tiles up and across; u starts anew at the back. */
    "  float aspect = btf_size.x / btf_size.y, latitude = atan(normal.z, length(normal.xy));\n"
    "  vec2 uv = 3.0 * vec2(atan(normal.y, normal.x) / pi, (latitude / pi + 0.5) * aspect);\n"
    /* The longer axis of the pixel's footprint in texels counts; a power of two of it is a level. */
    "  vec2 dx = dFdx(uv) * btf_size.xy, dy = dFdy(uv) * btf_size.xy;\n"
    "  float lod = log2(max(max(length(dx), length(dy)), 1.0));\n"
    "  vec3 irradiance = vec3(pi * max(to_light.z, 0.0));\n"
    "  vec3 radiance = inside < 0.0 ? vec3(0.18) : btf_eval(to_light, to_eye, uv, lod) * irradiance;\n"
    "  vec3 dark = radiance * 12.92, bright = 1.055 * pow(radiance, vec3(1.0 / 2.4)) - 0.055;\n"
    "  color = vec4(mix(bright, dark, lessThan(radiance, vec3(0.0031308))), 1.0);\n"
    "}\n";

#endif
