/* SPDX-License-Identifier: MIT */
#include "gl_host.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <GL/glcorearb.h>

#define GL_FUNCTIONS(X)                                                                                      \
  X(PFNGLGETSTRINGPROC, GetString)                                                                           \
  X(PFNGLGETERRORPROC, GetError)                                                                             \
  X(PFNGLCOMPRESSEDTEXIMAGE2DPROC, CompressedTexImage2D)                                                     \
  X(PFNGLCOMPRESSEDTEXIMAGE3DPROC, CompressedTexImage3D)                                                     \
  X(PFNGLENABLEPROC, Enable)                                                                                 \
  X(PFNGLCREATESHADERPROC, CreateShader)                                                                     \
  X(PFNGLSHADERSOURCEPROC, ShaderSource)                                                                     \
  X(PFNGLCOMPILESHADERPROC, CompileShader)                                                                   \
  X(PFNGLGETSHADERIVPROC, GetShaderiv)                                                                       \
  X(PFNGLGETSHADERINFOLOGPROC, GetShaderInfoLog)                                                             \
  X(PFNGLCREATEPROGRAMPROC, CreateProgram)                                                                   \
  X(PFNGLATTACHSHADERPROC, AttachShader)                                                                     \
  X(PFNGLLINKPROGRAMPROC, LinkProgram)                                                                       \
  X(PFNGLGETPROGRAMIVPROC, GetProgramiv)                                                                     \
  X(PFNGLGETPROGRAMINFOLOGPROC, GetProgramInfoLog)                                                           \
  X(PFNGLDELETESHADERPROC, DeleteShader) X(PFNGLDELETEPROGRAMPROC, DeleteProgram)                            \
      X(PFNGLUSEPROGRAMPROC, UseProgram) X(PFNGLGETUNIFORMLOCATIONPROC, GetUniformLocation)                  \
          X(PFNGLUNIFORM1IPROC, Uniform1i) X(PFNGLGETUNIFORMBLOCKINDEXPROC, GetUniformBlockIndex)            \
              X(PFNGLUNIFORMBLOCKBINDINGPROC, UniformBlockBinding) X(PFNGLGENBUFFERSPROC, GenBuffers)        \
                  X(PFNGLDELETEBUFFERSPROC, DeleteBuffers) X(PFNGLBINDBUFFERPROC, BindBuffer)                \
                      X(PFNGLBINDBUFFERBASEPROC, BindBufferBase) X(PFNGLBUFFERDATAPROC, BufferData)          \
                          X(PFNGLGENTEXTURESPROC, GenTextures) X(PFNGLDELETETEXTURESPROC, DeleteTextures) X( \
                              PFNGLACTIVETEXTUREPROC, ActiveTexture) X(PFNGLBINDTEXTUREPROC, BindTexture)    \
                              X(PFNGLTEXPARAMETERIPROC, TexParameteri) X(PFNGLPIXELSTOREIPROC, PixelStorei)  \
                                  X(PFNGLTEXIMAGE2DPROC, TexImage2D) X(PFNGLTEXIMAGE3DPROC, TexImage3D)      \
                                      X(PFNGLGENFRAMEBUFFERSPROC,                                            \
                                        GenFramebuffers) X(PFNGLDELETEFRAMEBUFFERSPROC, DeleteFramebuffers)  \
                                          X(PFNGLBINDFRAMEBUFFERPROC, BindFramebuffer)                       \
                                              X(PFNGLFRAMEBUFFERTEXTURE2DPROC, FramebufferTexture2D)         \
                                                  X(PFNGLCHECKFRAMEBUFFERSTATUSPROC, CheckFramebufferStatus) \
                                                      X(PFNGLGENVERTEXARRAYSPROC, GenVertexArrays)           \
                                                          X(PFNGLBINDVERTEXARRAYPROC, BindVertexArray)       \
                                                              X(PFNGLVIEWPORTPROC, Viewport)                 \
                                                                  X(PFNGLDRAWARRAYSPROC, DrawArrays)         \
                                                                      X(PFNGLREADPIXELSPROC, ReadPixels)

enum { SIDE = 256 /* of the picture that queries are drawn in */ };

typedef struct gl_host {
  gpu_host host;
  gl_dialect dialect;
  EGLDisplay display;
  EGLContext context;
  GLuint program, textures[FOLDER_MOST_TEXTURES], texture_count, block, queries[3], target, frame, vertices;
  char message[4096];
#define DECLARE(type, name) type name;
  GL_FUNCTIONS(DECLARE)
#undef DECLARE
} gl_host;

static const char *const names[GL_DIALECTS] = {"GLSL ES 3.00", "GLSL 3.30", "GLSL 4.50"};

const char *gl_dialect_name(gl_dialect dialect) {
  return names[dialect];
}

/* ---- context ---- */

static bool make_context(gl_host *h, const char **why) {
  const PFNEGLGETPLATFORMDISPLAYEXTPROC get_display =
      (PFNEGLGETPLATFORMDISPLAYEXTPROC)eglGetProcAddress("eglGetPlatformDisplayEXT");
  const EGLint es[] = {EGL_CONTEXT_MAJOR_VERSION, 3, EGL_CONTEXT_MINOR_VERSION, 0, EGL_NONE};
  const EGLint core33[] = {EGL_CONTEXT_MAJOR_VERSION, 3, EGL_CONTEXT_MINOR_VERSION, 3, EGL_NONE};
  const EGLint core45[] = {EGL_CONTEXT_MAJOR_VERSION, 4, EGL_CONTEXT_MINOR_VERSION, 5, EGL_NONE};
  const EGLint *const attributes[GL_DIALECTS] = {es, core33, core45};
  *why = "EGL has no display without a window";
  if (get_display == NULL) return false;
  h->display = get_display(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, NULL);
  if (h->display == EGL_NO_DISPLAY || !eglInitialize(h->display, NULL, NULL)) return false;
  *why = "EGL makes no context of this version";
  if (!eglBindAPI(h->dialect == GL_ES_300 ? EGL_OPENGL_ES_API : EGL_OPENGL_API)) return false;
  h->context = eglCreateContext(h->display, EGL_NO_CONFIG_KHR, EGL_NO_CONTEXT, attributes[h->dialect]);
  if (h->context == EGL_NO_CONTEXT) return false;
  return eglMakeCurrent(h->display, EGL_NO_SURFACE, EGL_NO_SURFACE, h->context);
}

static bool get_functions(gl_host *h) {
  bool all = true;
#define GET(type, name)                                                                                      \
  h->name = (type)eglGetProcAddress("gl" #name);                                                             \
  all = all && h->name != NULL;
  GL_FUNCTIONS(GET)
#undef GET
  return all;
}

/* A picture of floats, without filter. */
static void make_picture(gl_host *h, GLuint texture) {
  h->BindTexture(GL_TEXTURE_2D, texture);
  h->TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  h->TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  h->TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32F, SIDE, SIDE, 0, GL_RGBA, GL_FLOAT, NULL);
}

static void unload(gl_host *h) {
  if (h->program != 0) h->DeleteProgram(h->program);
  if (h->texture_count > 0) h->DeleteTextures((GLsizei)h->texture_count, h->textures);
  if (h->block != 0) h->DeleteBuffers(1, &h->block);
  h->program = h->texture_count = h->block = 0;
}

static void close_host(gpu_host *host) {
  gl_host *h = (gl_host *)host;
  if (h->frame != 0) unload(h);
  if (h->display != EGL_NO_DISPLAY) {
    eglMakeCurrent(h->display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    if (h->context != EGL_NO_CONTEXT) eglDestroyContext(h->display, h->context);
    eglTerminate(h->display);
  }
  free(h);
}

/* ---- the export ---- */

static GLenum target_of(const folder_texture *t) {
  return t->dimension == BTF_TEXTURE_3D         ? GL_TEXTURE_3D
         : t->dimension == BTF_TEXTURE_2D_ARRAY ? GL_TEXTURE_2D_ARRAY
                                                : GL_TEXTURE_2D;
}

typedef struct upload_format {
  uint32_t vk;
  GLint internal;
  GLenum format, type; /* 0 = blocks */
} upload_format;

static const upload_format *upload_format_of(uint32_t vk) {
  static const upload_format formats[] = {
      {9, GL_R8, GL_RED, GL_UNSIGNED_BYTE},
      {16, GL_RG8, GL_RG, GL_UNSIGNED_BYTE},
      {37, GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE},
      {38, GL_RGBA8_SNORM, GL_RGBA, GL_BYTE},
      {76, GL_R16F, GL_RED, GL_HALF_FLOAT},
      {83, GL_RG16F, GL_RG, GL_HALF_FLOAT},
      {97, GL_RGBA16F, GL_RGBA, GL_HALF_FLOAT},
      {100, GL_R32F, GL_RED, GL_FLOAT},
      {103, GL_RG32F, GL_RG, GL_FLOAT},
      {109, GL_RGBA32F, GL_RGBA, GL_FLOAT},
      {143, GL_COMPRESSED_RGB_BPTC_UNSIGNED_FLOAT, 0, 0},
      {144, GL_COMPRESSED_RGB_BPTC_SIGNED_FLOAT, 0, 0},
      {145, GL_COMPRESSED_RGBA_BPTC_UNORM, 0, 0},
  };
  for (size_t i = 0; i < sizeof formats / sizeof *formats; i++)
    if (formats[i].vk == vk) return &formats[i];
  return NULL;
}

static const char *put_texture(gl_host *h, const folder_texture *t) {
  const ktx2_texture *file = &t->file;
  const upload_format *f = upload_format_of(file->vk_format);
  const GLenum at = target_of(t);
  if (f == NULL) return "a texture has texels of an unknown format";
  h->GenTextures(1, &h->textures[h->texture_count]);
  h->BindTexture(at, h->textures[h->texture_count++]);
  h->TexParameteri(at, GL_TEXTURE_WRAP_S, t->repeat[0] ? GL_REPEAT : GL_CLAMP_TO_EDGE);
  h->TexParameteri(at, GL_TEXTURE_WRAP_T, t->repeat[1] ? GL_REPEAT : GL_CLAMP_TO_EDGE);
  h->TexParameteri(at, GL_TEXTURE_WRAP_R, GL_CLAMP_TO_EDGE);
  h->TexParameteri(at, GL_TEXTURE_MAX_LEVEL, (GLint)file->levels - 1);
  h->TexParameteri(at, GL_TEXTURE_MAG_FILTER, t->filtered ? GL_LINEAR : GL_NEAREST);
  h->TexParameteri(at, GL_TEXTURE_MIN_FILTER,
                   t->filtered ? GL_LINEAR_MIPMAP_LINEAR : GL_NEAREST_MIPMAP_NEAREST);
  for (uint32_t l = 0; l < file->levels; l++) {
    const GLsizei w = (GLsizei)(file->width >> l ? file->width >> l : 1),
                  v = (GLsizei)(file->height >> l ? file->height >> l : 1);
    const GLsizei bytes = (GLsizei)file->level_size[l];
    if (f->format == 0 && at == GL_TEXTURE_2D)
      h->CompressedTexImage2D(at, (GLint)l, (GLenum)f->internal, w, v, 0, bytes, file->level[l]);
    else if (f->format == 0)
      h->CompressedTexImage3D(at, (GLint)l, (GLenum)f->internal, w, v, (GLsizei)t->slices, 0, bytes,
                              file->level[l]);
    else if (at == GL_TEXTURE_2D)
      h->TexImage2D(at, (GLint)l, f->internal, w, v, 0, f->format, f->type, file->level[l]);
    else
      h->TexImage3D(at, (GLint)l, f->internal, w, v, (GLsizei)t->slices, 0, f->format, f->type,
                    file->level[l]);
  }
  return h->GetError() == GL_NO_ERROR ? NULL : "GL refuses a texture";
}

static GLuint compile(gl_host *h, GLenum kind, const char *body, const char *tail) {
  static const char *const versions[GL_DIALECTS] = {"#version 300 es\nprecision highp float;\n",
                                                    "#version 330 core\n", "#version 450 core\n"};
  const char *const parts[] = {versions[h->dialect], body, tail};
  const GLuint shader = h->CreateShader(kind);
  GLint compiled = 0;
  h->ShaderSource(shader, 3, parts, NULL);
  h->CompileShader(shader);
  h->GetShaderiv(shader, GL_COMPILE_STATUS, &compiled);
  if (compiled) return shader;
  h->GetShaderInfoLog(shader, sizeof h->message, NULL, h->message);
  h->DeleteShader(shader);
  return 0;
}

static const char vertex_shader[] =
    "void main() {\n"
    "  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);\n"
    "}\n";
static const char fragment_tail[] =
    "uniform highp sampler2D query0, query1, query2;\n"
    "layout(location = 0) out vec4 result;\n"
    "void main() {\n"
    "  ivec2 at = ivec2(gl_FragCoord.xy);\n"
    "  vec4 a = texelFetch(query0, at, 0), b = texelFetch(query1, at, 0), c = texelFetch(query2, at, 0);\n"
    "  result = vec4(btf_eval(a.xyz, vec3(a.w, b.xy), b.zw, c.x), 1.0);\n"
    "}\n";

static const char *make_program(gl_host *h, const char *glsl) {
  const GLuint vertex = compile(h, GL_VERTEX_SHADER, "", vertex_shader);
  const GLuint fragment = vertex != 0 ? compile(h, GL_FRAGMENT_SHADER, glsl, fragment_tail) : 0;
  GLint linked = 0;
  if (fragment == 0) return h->message;
  h->program = h->CreateProgram();
  h->AttachShader(h->program, vertex);
  h->AttachShader(h->program, fragment);
  h->LinkProgram(h->program);
  h->DeleteShader(vertex);
  h->DeleteShader(fragment);
  h->GetProgramiv(h->program, GL_LINK_STATUS, &linked);
  if (linked) return NULL;
  h->GetProgramInfoLog(h->program, sizeof h->message, NULL, h->message);
  return h->message;
}

static void bind(gl_host *h, const char *name, GLuint unit, GLenum target, GLuint texture) {
  h->ActiveTexture(GL_TEXTURE0 + unit);
  h->BindTexture(target, texture);
  h->Uniform1i(h->GetUniformLocation(h->program, name), (GLint)unit);
}

static void bind_all(gl_host *h, const gpu_folder *folder) {
  static const char *const names_of_queries[] = {"query0", "query1", "query2"};
  h->UseProgram(h->program);
  for (GLuint i = 0; i < h->texture_count; i++) {
    const folder_texture *t = &folder->textures[i];
    bind(h, t->name, i + 3, target_of(t), h->textures[i]);
  }
  for (GLuint i = 0; i < 3; i++) bind(h, names_of_queries[i], i, GL_TEXTURE_2D, h->queries[i]);
  const GLuint block = h->GetUniformBlockIndex(h->program, "btf_uniforms");
  if (block != GL_INVALID_INDEX) h->UniformBlockBinding(h->program, block, 0);
  h->BindBufferBase(GL_UNIFORM_BUFFER, 0, h->block);
}

static const char *load(gpu_host *host, const gpu_folder *folder) {
  gl_host *h = (gl_host *)host;
  const char *wrong = NULL;
  unload(h);
  h->ActiveTexture(GL_TEXTURE0);
  for (uint32_t i = 0; wrong == NULL && i < folder->texture_count; i++)
    wrong = put_texture(h, &folder->textures[i]);
  if (wrong == NULL) wrong = make_program(h, folder->glsl);
  if (wrong != NULL) return wrong;
  h->GenBuffers(1, &h->block);
  h->BindBuffer(GL_UNIFORM_BUFFER, h->block);
  h->BufferData(GL_UNIFORM_BUFFER, (GLsizeiptr)folder->block_size, folder->block, GL_STATIC_DRAW);
  bind_all(h, folder);
  return h->GetError() == GL_NO_ERROR ? NULL : "GL refuses the export";
}

/* ---- queries ---- */

static void put_queries(gl_host *h, const float *queries, size_t count) {
  static float pictures[3][SIDE * SIDE][4];
  memset(pictures, 0, sizeof pictures);
  for (size_t i = 0; i < count; i++)
    for (size_t k = 0; k < 9; k++) pictures[k / 4][i][k % 4] = queries[9 * i + k];
  for (GLuint p = 0; p < 3; p++) {
    h->ActiveTexture(GL_TEXTURE0 + p);
    h->BindTexture(GL_TEXTURE_2D, h->queries[p]);
    h->TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32F, SIDE, SIDE, 0, GL_RGBA, GL_FLOAT, pictures[p]);
  }
}

static const char *evaluate(gpu_host *host, const float *queries, size_t count, float *out) {
  gl_host *h = (gl_host *)host;
  static float picture[SIDE * SIDE][4];
  while (count > 0) {
    const size_t n = count < SIDE * SIDE ? count : SIDE * SIDE;
    put_queries(h, queries, n);
    h->Viewport(0, 0, SIDE, SIDE);
    h->DrawArrays(GL_TRIANGLES, 0, 3);
    h->ReadPixels(0, 0, SIDE, SIDE, GL_RGBA, GL_FLOAT, picture);
    if (h->GetError() != GL_NO_ERROR) return "GL cannot draw the queries";
    for (size_t i = 0; i < n; i++) memcpy(out + 3 * i, picture[i], 3 * sizeof(float));
    queries += 9 * n;
    out += 3 * n;
    count -= n;
  }
  return NULL;
}

gpu_host *gl_host_open(gl_dialect dialect, const char **why) {
  gl_host *h = calloc(1, sizeof *h);
  *why = "no memory";
  if (h == NULL) return NULL;
  h->host = (gpu_host){load, evaluate, close_host, ""};
  h->dialect = dialect;
  if (!make_context(h, why) || !get_functions(h)) {
    close_host(&h->host);
    return NULL;
  }
  h->GenTextures(3, h->queries);
  h->GenTextures(1, &h->target);
  for (int i = 0; i < 3; i++) make_picture(h, h->queries[i]);
  make_picture(h, h->target);
  h->GenFramebuffers(1, &h->frame);
  h->BindFramebuffer(GL_FRAMEBUFFER, h->frame);
  h->FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, h->target, 0);
  h->GenVertexArrays(1, &h->vertices);
  h->BindVertexArray(h->vertices);
  h->PixelStorei(GL_UNPACK_ALIGNMENT, 1);
  *why = "a picture of floats cannot be drawn to";
  if (h->CheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
    close_host(&h->host);
    return NULL;
  }
  *why = NULL;
  snprintf(h->host.name, sizeof h->host.name, "%s", (const char *)h->GetString(GL_RENDERER));
  return &h->host;
}
