from glob import glob

from setuptools import find_packages, setup

NAME = 'humanopts_teach'

setup(
    name=NAME,
    version='0.1.0',
    install_requires=[
        'babel>=2.10.3',
        'jinja2>=3.1.2',
        'lazy-loader>=0.3',
        'markdown-it-py>=3.0.0',
        'matplotlib>=3.6.3',
        'numpy>=1.26.4',
        'pandas>=2.1.4',
        'pillow>=10.2.0',
        'prompt-toolkit>=3.0.43',
        'psutil>=5.9.8',
        'pyyaml>=6.0.1',
        'rich>=13.7.1',
        'scikit-learn>=1.4.1',
        'setproctitle>=1.3.3',
        'statsmodels>=0.14.1',
        'zstandard>=0.22.0',
    ],
    packages=find_packages(exclude=['test']),
    package_data={
        NAME: [
            'py.typed',
            '__init__.pyi',
            'gamepad.yaml',
            'locale/*.po',
            'report/*.html',
            'report/*.css',
            'report/*.txt',
            'browser/page.*',
            'study/*.html',
            'study/*.yaml',
            'study/analysis.R',
        ]
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/launch', glob('launch/*.launch.py')),
        (f'share/{NAME}/viewers', glob('viewers/*')),
    ],
    extras_require={
        'dask': ['dask', 'distributed'],
        'minari': ['minari[arrow]'],
        'parquet': ['pyarrow'],
    },
    entry_points={
        'console_scripts': [
            'humanopts = humanopts_teach.cli:main',
            'diagnostics = humanopts_teach.ros.diagnostics:main',
            'joy_teleop = humanopts_teach.ros.joy_teleop:main',
            'keyboard_teleop = humanopts_teach.ros.keyboard_teleop:main',
            'lesson = humanopts_teach.ros.lesson_node:main',
            'recorder = humanopts_teach.ros.recorder:main',
            'simulated_teacher = humanopts_teach.ros.simulated_teacher:main',
            'views = humanopts_teach.ros.views:main',
        ],
    },
)
