// What the compiler does not find: names that nothing uses, promises that nobody awaits, conditions that are always true.
import js from "@eslint/js";
import typescript from "typescript-eslint";

export default typescript.config(
  js.configs.recommended,
  ...typescript.configs.recommendedTypeChecked,
  {
    languageOptions: { parserOptions: { project: "./tsconfig.json", tsconfigRootDir: import.meta.dirname } },
    rules: {
      "no-undef": "off", // the compiler knows
      "@typescript-eslint/unbound-method": "off", // actions are closures that stand in an object
    },
  },
  { files: ["tests/**"], rules: { "@typescript-eslint/no-floating-promises": "off" } }, // the runner awaits its tests
);
