"""Images as labs have them: errors and error bars where more changes than the motion."""

ROBUSTNESS = "results/robustness"
FRAMES = [f"frame{k + 1}" for k in range(len(settings.robustness.frames))]
BUBBLES = ["dense", "sparse", "brightest", "coherent", "large"]
TEXTURES = ["octaves", "discs", "log_layers", "photo", "ground"]
SCENES = [*BUBBLES, *TEXTURES, *FRAMES]
HALVES = ["tuned", "held"]


rule robustness:
    input:
        f"{ROBUSTNESS}/errors.csv",


rule robustness_pair:
    input:
        frame=lambda wildcards: [
            settings.robustness.frames[FRAMES.index(wildcards.scene)]
            for _ in range(wildcards.scene in FRAMES)
        ],
        code=code("robustness_pair.py"),
    output:
        f"{ROBUSTNESS}/pairs/{{scene}}-{{half}}.csv",
    log:
        "logs/robustness/{scene}-{half}.log",
    benchmark:
        "benchmarks/robustness/{scene}-{half}.tsv"
    wildcard_constraints:
        scene="|".join(SCENES),
        half="|".join(HALVES),
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=2000,
    params:
        robustness=settings.robustness.model_dump(),
    script:
        "../scripts/robustness_pair.py"


rule robustness_table:
    input:
        expand(
            "{folder}/pairs/{scene}-{half}.csv",
            folder=ROBUSTNESS,
            scene=SCENES,
            half=HALVES,
        ),
    output:
        f"{ROBUSTNESS}/errors.csv",
    log:
        "logs/robustness/table.log",
    benchmark:
        "benchmarks/robustness/table.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=500,
    shell:
        "awk 'FNR > 1 || NR == 1' {input} > {output} 2> {log}"
