#version 300 es
// A Gaussian as a rectangle around its footprint: the projection of 3D Gaussian splatting (Kerbl et
// al. 2023, Zwicker et al. 2002), as in the crate radiance.
precision highp float;
precision highp int;
precision highp usampler2D;

// Two texels a Gaussian: mean (3 floats) and rotation; log-scales, opacity and radiance (half floats).
uniform usampler2D map;
// Ten texels for each of the first Gaussians, whose colour depends on the direction: rotation, spread
// and number of terms, then a term each.
uniform usampler2D views;
uniform float viewColours;
uniform mat3 cameraFromWorld;
uniform vec3 origin;
uniform vec2 focal;
uniform vec2 principal;
uniform vec2 size;
// The range of x/z and y/z in which the Jacobian is taken at the mean.
uniform vec2 rangeLow;
uniform vec2 rangeHigh;
uniform vec2 depthRange;
uniform float screenVariance;
uniform float alphaMin;

in vec2 corner;
in uint index;
out vec2 offset;
flat out vec4 light;

const float QUATERNION_RANGE = 0.70710678;

// World-from-Gaussian, from a quaternion without its largest component.
mat3 axes(uint packed) {
  vec3 rest = vec3(packed & 1023u, packed >> 10 & 1023u, packed >> 20 & 1023u) / 1023.0;
  rest = (2.0 * rest - 1.0) * QUATERNION_RANGE;
  float largest = sqrt(max(0.0, 1.0 - dot(rest, rest)));
  uint place = packed >> 30;
  vec4 q = place == 0u ? vec4(largest, rest)
    : place == 1u ? vec4(rest.x, largest, rest.yz)
    : place == 2u ? vec4(rest.xy, largest, rest.z)
    : vec4(rest, largest);
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// What the radiance of a Gaussian is multiplied by, seen along a unit vector (crate radiance,
// view_colour.rs).
vec3 viewGain(uint index, vec3 direction) {
  const float LIMIT = 1.5 * 0.69314718;
  ivec2 place = ivec2(int(index % 204u) * 10, int(index / 204u));
  uvec4 cone = texelFetch(views, place, 0);
  mat3 rotation = axes(cone.x);
  vec2 v = vec2(dot(rotation[0], direction), dot(rotation[1], direction)) / uintBitsToFloat(cone.y);
  vec2 s = v * inversesqrt(1.0 + dot(v, v));
  float x = s.x, y = s.y, r2 = dot(s, s);
  float terms[9] = float[9](x, y, 2.0 * x * y, x * x - y * y, r2,
    x * (x * x - 3.0 * y * y), y * (3.0 * x * x - y * y), x * r2, y * r2);
  vec3 sum = vec3(0.0);
  for (int k = 0; k < int(cone.z); k++) {
    sum += terms[k] * uintBitsToFloat(texelFetch(views, place + ivec2(1 + k, 0), 0).xyz);
  }
  return exp(LIMIT * tanh(sum / LIMIT));
}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  ivec2 place = ivec2(int(index & 1023u) * 2, int(index >> 10));
  uvec4 first = texelFetch(map, place, 0);
  uvec4 second = texelFetch(map, place + ivec2(1, 0), 0);
  vec3 ray = uintBitsToFloat(first.xyz) - origin;
  vec3 p = cameraFromWorld * ray;
  vec2 zo = unpackHalf2x16(second.y);
  if (p.z < depthRange.x || p.z > depthRange.y || zo.y < alphaMin) return;

  vec3 scale = exp(vec3(unpackHalf2x16(second.x), zo.x));
  mat3 a = cameraFromWorld * axes(first.w);
  vec2 ratio = clamp(p.xy / p.z, rangeLow, rangeHigh);
  // Rows of J W R S.
  vec3 row0 = scale * vec3(a[0].x - ratio.x * a[0].z, a[1].x - ratio.x * a[1].z, a[2].x - ratio.x * a[2].z);
  vec3 row1 = scale * vec3(a[0].y - ratio.y * a[0].z, a[1].y - ratio.y * a[1].z, a[2].y - ratio.y * a[2].z);
  row0 *= focal.x / p.z;
  row1 *= focal.y / p.z;
  float xx = dot(row0, row0) + screenVariance;
  float xy = dot(row0, row1);
  float yy = dot(row1, row1) + screenVariance;

  // Principal axes of the footprint; the rectangle ends where opacity falls below alphaMin.
  float middle = 0.5 * (xx + yy);
  float spread = length(vec2(0.5 * (xx - yy), xy));
  vec2 variances = vec2(middle + spread, max(middle - spread, screenVariance));
  vec2 along = abs(xy) > 1e-6 * middle ? normalize(vec2(xy, variances.x - xx))
    : xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0);
  offset = corner * sqrt(2.0 * log(zo.y / alphaMin));
  vec2 deviation = sqrt(variances) * offset;
  vec2 pixel = focal * p.xy / p.z + principal;
  pixel += deviation.x * along + deviation.y * vec2(-along.y, along.x);
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
  light = vec4(unpackHalf2x16(second.z), unpackHalf2x16(second.w).x, zo.y);
  if (index < uint(viewColours)) light.rgb *= viewGain(index, normalize(ray));
}
