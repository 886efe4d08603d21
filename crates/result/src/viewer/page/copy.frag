#version 300 es
// A coarser level, which the blend lets through where the finer one is open. A fine pixel at i lies
// at (i + 0.5) / 2 of the coarse one, also where sizes are odd.
precision highp float;
precision highp sampler2D;
uniform sampler2D light;
out vec4 copied;

void main() {
  copied = texture(light, gl_FragCoord.xy / (2.0 * vec2(textureSize(light, 0))));
}
