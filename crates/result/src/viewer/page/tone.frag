#version 300 es
// Radiance to picture values: response(exposure * white balance * radiance).
precision highp float;
precision highp sampler2D;
uniform sampler2D light;
// Picture values at linear values that are evenly spaced in the fourth root.
uniform sampler2D response;
uniform vec3 gain;
in vec2 place;
out vec4 picture;

void main() {
  vec3 linear = clamp(gain * texture(light, place).rgb, 0.0, 1.0);
  int last = textureSize(response, 0).x - 1;
  vec3 at = sqrt(sqrt(linear)) * float(last);
  vec3 value;
  for (int c = 0; c < 3; c++) {
    int left = min(int(at[c]), last - 1);
    float a = texelFetch(response, ivec2(left, 0), 0)[c];
    float b = texelFetch(response, ivec2(left + 1, 0), 0)[c];
    value[c] = mix(a, b, at[c] - float(left));
  }
  picture = vec4(value, 1.0);
}
